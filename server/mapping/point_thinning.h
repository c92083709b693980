#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

namespace soundmap::mapping {

// Indices of points of which each is the first in its cube of this size, in order. Points too far
// out for a voxel key are left out.
std::vector<std::uint32_t> FirstPointPerCube(std::span<const Eigen::Vector3f> points,
                                             double cube_size_m);

// These points themselves.
std::vector<Eigen::Vector3f> ThinPoints(std::span<const Eigen::Vector3f> points,
                                        double cube_size_m);

// Points of a scan to align it by.
struct AlignedPoints {
  std::vector<Eigen::Vector3f> points;
  double stands_for = 1.0;  // so many points each
};

// One point in each cube of a part of the surfaces' voxel size, and of these, evenly over their
// order, about as many as are needed.
AlignedPoints PointsToAlign(std::span<const Eigen::Vector3f> points, double surface_voxel_size_m);

}  // namespace soundmap::mapping
