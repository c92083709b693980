#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "soundmap/poses.h"

namespace soundmap::cli {

// Poses (map_from_base), oldest first: lines `timestamp_s,x,y,yaw` (CSV, with or without that
// header) or TUM's `timestamp x y z qx qy qz qw`, of which x, y and yaw are kept; `#` begins a
// comment. InvalidArgument names the file and the line: another shape, a number that is none or not
// finite, a quaternion far from unit length, a time that does not grow, no pose at all.
absl::StatusOr<std::vector<StampedPose>> ReadPoseFile(const std::string& path);

// A line `t1 t2 dx dy dz roll pitch yaw` of a SLAM benchmark's relations: the pose at t2 as seen
// from the pose at t1, in metres and radians.
struct Relation {
  std::int64_t time1_ns = 0;
  std::int64_t time2_ns = 0;
  Vector3 translation_m;
  double roll_rad = 0.0;
  double pitch_rad = 0.0;
  double yaw_rad = 0.0;
};

absl::StatusOr<std::vector<Relation>> ReadRelationFile(const std::string& path);

}  // namespace soundmap::cli
