#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/frames.h"
#include "mapping/mapper.h"

namespace soundmap::mapping {

struct RecordedDrive {
  frames::Calibration calibration;
  std::vector<frames::Frame> frames;  // LIDAR and odometry alone
  std::vector<StampedPose> truth;
};

absl::StatusOr<RecordedDrive> ReadDrive(const std::string& path);

// map_from_base at the time, between the poses on either side; the nearest end outside.
geometry::Pose2 PoseAt(const std::vector<StampedPose>& poses, frames::TimeNs time_ns);

}  // namespace soundmap::mapping
