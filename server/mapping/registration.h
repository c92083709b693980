#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "geometry/pose.h"
#include "mapping/surface_map.h"

namespace soundmap::mapping {

// How far the pose may be from the one that the search starts with.
struct SearchRange {
  double start_distance_m = 0.3;  // between a point and its surfel in the first iteration
  double prior_std_m = 0.1;       // of the starting pose, each of x and y
  double prior_std_rad = 0.05;
};

struct Registration {
  geometry::Pose2 map_from_base;
  int constraints = 0;           // points with a vertical surface near them
  int inliers = 0;               // of these, points that lie on it
  double overlap = 0.0;          // points with anything mapped near them among all, 0 to 1
  double mean_residual_m = 0.0;  // of the inliers, to their surfaces

  // Among the constraints, 0 to 1.
  double fit() const { return constraints > 0 ? static_cast<double>(inliers) / constraints : 0.0; }
};

// Scan-to-map alignment on the flat floor: x, y and yaw that minimize the distances of the scan's
// points to the planes of the nearest surfels, under a Cauchy kernel whose width follows the
// residuals, by Gauss-Newton. z, roll and pitch stay (section II-A). The starting pose keeps weight
// where the surfaces leave a direction open, as in a corridor.
Registration Register(std::span<const Eigen::Vector3f> point_in_base, const SurfaceMap& map,
                      const geometry::Pose2& start_map_from_base, const SearchRange& range);

}  // namespace soundmap::mapping
