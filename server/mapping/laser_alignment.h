#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "frames/frames.h"
#include "geometry/pose.h"
#include "mapping/laser_lines.h"
#include "mapping/laser_matching.h"

namespace soundmap::mapping {

// A scan of a drive that was used.
struct LaserPathEntry {
  frames::TimeNs stamp_ns = 0;
  geometry::Pose2 odom_from_base;
  geometry::Pose2 map_from_base;
  std::optional<std::size_t> key_scan;  // the last one at or before this scan
};

// Below this a match is not believed.
inline constexpr int kMinMatchInliers = 20;
inline constexpr double kMinMatchFit = 0.5;

// How far odometry may err over a step: by a part of it, and at least by a little.
double StepStd_m(double step_m);
double StepStd_rad(double step_rad);

// Aligns a scan to the walls of the last metres of a path (not empty), from where the odometry puts
// it; the worse that fits, the wider is the search. `unregistered`: scans just before that fitted
// nothing.
LaserMatch AlignToPath(const std::vector<Eigen::Vector2f>& point_in_base, const LineMap& lines,
                       const std::vector<LaserPathEntry>& path, int unregistered,
                       const geometry::Pose2& predicted, const geometry::Pose2& odom_from_base,
                       frames::TimeNs stamp_ns, bool odometry_is_sound);

}  // namespace soundmap::mapping
