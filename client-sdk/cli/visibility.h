#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "cli/drive_truth.h"
#include "cli/truth_file.h"
#include "soundmap/poses.h"

namespace soundmap::cli {

// Where the microphone array was.
struct ArrayPosition {
  std::int64_t time_ns = 0;
  Vector3 in_map_m;
};

std::vector<ArrayPosition> ArrayPath(const std::vector<StampedPose>& map_from_base,
                                     const Vector3& array_in_base_m);

// Whether the straight line from `array` to `source` meets nothing. The surfaces of the room and of
// the obstacles are part of the free space (a grill lies in the ceiling), but for 2 cm of
// tolerance; an obstacle around the source is the source's own housing.
bool IsUnobstructed(const Vector3& array_in_map_m, const Vector3& source_in_map_m,
                    const SceneTruth& scene);

// Which sources could have been heard: while on, unobstructed and within `max_range_m` of the array
// for 5 s or more in all, and from two positions or more that lie 1 m apart. `path` is by time; a
// gap of more than 1 s in it is no time in view.
std::vector<bool> SourcesInView(const SceneTruth& scene, const std::vector<ArrayPosition>& path,
                                std::int64_t drive_start_ns, double max_range_m);

// The same of the drive recorded in the file `recording`. FailedPrecondition: it does not say where
// the array was, or the range is unknown.
absl::StatusOr<std::vector<bool>> SourcesInView(const SceneTruth& scene, const DriveTruth& drive,
                                                double max_range_m, const std::string& recording);

}  // namespace soundmap::cli
