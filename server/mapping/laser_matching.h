#pragma once

#include <Eigen/Core>
#include <span>

#include "geometry/pose.h"
#include "mapping/laser_lines.h"

namespace soundmap::mapping {

// How far the pose may be from the one that the search starts with.
struct LaserSearchRange {
  double start_distance_m = 0.3;  // between a point and its piece of wall in the first iteration
  double prior_std_m = 0.1;       // of the starting pose, each of x and y
  double prior_std_rad = 0.05;
};

struct LaserMatch {
  geometry::Pose2 map_from_base;
  int points = 0;
  int near = 0;                  // points with a piece of wall near them
  int constraints = 0;           // of these, with a line
  int inliers = 0;               // of these, points that lie on it
  double mean_residual_m = 0.0;  // of the inliers
  // Inverse covariance of (x, y, yaw) in the axes of base_link; what the walls say, the prior left
  // out.
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();

  double overlap() const { return points > 0 ? static_cast<double>(near) / points : 0.0; }
  // Among the constraints, 0 to 1.
  double fit() const { return constraints > 0 ? static_cast<double>(inliers) / constraints : 0.0; }
};

// Scan-to-map alignment: x, y and yaw that minimize the distances of the points to the lines of the
// nearest pieces of wall, under a Cauchy kernel whose width follows the residuals, by Gauss-Newton.
// The starting pose keeps weight where the walls leave a direction open, as in a corridor.
LaserMatch MatchToLines(std::span<const Eigen::Vector2f> point_in_base, const LineMap& map,
                        const geometry::Pose2& start_map_from_base, const LaserSearchRange& range);

}  // namespace soundmap::mapping
