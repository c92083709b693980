#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "soundmap/poses.h"

namespace soundmap::cli {

// What a recording knows beside its sensor data.
struct DriveTruth {
  std::int64_t start_ns = 0;               // log time of the first message
  std::vector<StampedPose> map_from_base;  // /ground_truth/pose, by time; may be empty
  std::optional<Vector3> array_in_base_m;  // origin of `mic_array`, from /tf_static
  std::string warning;  // a sentence when the file is damaged; what stands before is used
};

// InvalidArgument: not a recording, no message, a ground truth that is not in the frame `map` or
// not finite.
absl::StatusOr<DriveTruth> ReadDriveTruth(const std::string& path);

}  // namespace soundmap::cli
