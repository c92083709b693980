#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "absl/status/status.h"
#include "geometry/pose.h"
#include "mapping/floor_plan_mapper.h"
#include "mapping/laser_points.h"

namespace soundmap::mapping {

// A scan that is kept.
struct LaserKeyScan {
  std::size_t path_index = 0;
  LaserPoints points;
  std::vector<Eigen::Vector2f> point_to_match;  // fewer
  geometry::Pose2 map_from_base;
  // Of the step from the key scan before: (x, y, yaw) in the axes of this one.
  Eigen::Matrix3d step_covariance = Eigen::Matrix3d::Zero();
  // From the start of the drive; longer than the way where scans fitted nothing.
  double way_m = 0.0;
  // The first of a drive: the step to it from the last one of another drive is how it was placed.
  bool begins_drive = false;
  // Not a scan but the walls of a map that exists. Only the first can be.
  bool is_map = false;
};

struct LoopReport {
  int loops_closed = 0;
  int loops_refused = 0;
};

// Key scans in order of the drive, or of one drive after another; each is placed against the ones
// before it alone. Looks in order of
// the drive for stretches at places seen before (branch and bound, then alignment), weighs what was
// found in a robust pose graph and moves all key scans accordingly; the first stays. Cancelled when
// `progress` (0 .. 1) returns false.
absl::Status CloseLoops(const FloorPlanMapperConfig& config,
                        const std::function<bool(double)>& progress,
                        std::vector<LaserKeyScan>& key_scans, LoopReport& report);

}  // namespace soundmap::mapping
