#pragma once

#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "mapping/surface_map.h"

namespace soundmap::mapping {

// How far the pose may be from the one that the search starts with.
struct SearchRange {
  double start_distance_m = 0.3;  // between a point and its surfel in the first iteration
  double prior_std_m = 0.1;       // of the starting pose, each of x and y
  double prior_std_rad = 0.05;    // of its yaw
  // Of its z, and of its roll and pitch. A wheeled robot starts flat on the floor and stays so but
  // for what the floor is uneven.
  double prior_std_z_m = 0.02;
  double prior_std_tilt_rad = 0.01;
  // How many points of the scan each of those given stands for: its weight against the prior.
  double point_weight = 1.0;
};

struct Registration {
  Eigen::Isometry3d map_from_base = Eigen::Isometry3d::Identity();
  int constraints = 0;   // points with a steep surface near them, which speaks for x, y, yaw
  int inliers = 0;       // of these, points that lie on it
  double overlap = 0.0;  // points with anything mapped near them among all, 0 to 1
  double mean_residual_m = 0.0;  // of the inliers, to their surfaces
  // What the surfaces say about (x, y, z, rx, ry, rz) in the frame of the found base, without the
  // prior: small where they leave a direction open, as along a corridor.
  Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();

  // Among the constraints, 0 to 1.
  double fit() const { return constraints > 0 ? static_cast<double>(inliers) / constraints : 0.0; }
};

// Scan-to-map alignment in 6 degrees of freedom: the pose that minimizes the distances of the
// scan's points to the planes of the nearest surfels, under a Cauchy kernel whose width follows the
// residuals, by Gauss-Newton. Distances shrink to what the map's voxels can tell. The starting pose
// keeps weight where the surfaces leave a direction open. Rotations are about the axes of `map`.
Registration Register(std::span<const Eigen::Vector3f> point_in_base, const SurfaceMap& map,
                      const Eigen::Isometry3d& start_map_from_base, const SearchRange& range);

// Surfaces at several resolutions, for poses that are not known as well as the finest asks for.
class SurfacePyramid {
 public:
  // Each level's voxels are twice as large as those of the one before; at least one level.
  SurfacePyramid(double finest_voxel_size_m, int levels);

  void Insert(std::span<const Eigen::Vector3f> point_in_map);
  void FitPlanes();
  const std::vector<SurfaceMap>& levels() const { return levels_; }  // finest first

 private:
  std::vector<SurfaceMap> levels_;
};

// Register() from the coarsest level to the finest, with points thinned to each. Finds poses about
// the coarsest voxel's size away. `range.start_distance_m` holds for the coarsest level.
Registration RegisterCoarseToFine(std::span<const Eigen::Vector3f> point_in_base,
                                  const SurfacePyramid& map,
                                  const Eigen::Isometry3d& start_map_from_base,
                                  const SearchRange& range);

// The same, and again from starts turned about each axis as long as the scan does not fit.
Registration RegisterFromFar(std::span<const Eigen::Vector3f> point_in_base,
                             const SurfacePyramid& map,
                             const Eigen::Isometry3d& start_map_from_base,
                             const SearchRange& range);

}  // namespace soundmap::mapping
