#include "mapping/point_thinning.h"

#include <boost/unordered/unordered_flat_set.hpp>

#include "geometry/voxel_key.h"

namespace soundmap::mapping {

std::vector<std::uint32_t> FirstPointPerCube(std::span<const Eigen::Vector3f> points,
                                             double cube_size_m) {
  boost::unordered_flat_set<geometry::VoxelKey, std::hash<geometry::VoxelKey>> taken;
  taken.reserve(points.size() / 4);
  std::vector<std::uint32_t> first;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto key = geometry::KeyFromPoint(points[i].cast<double>(), cube_size_m);
    if (key && taken.insert(*key).second) first.push_back(static_cast<std::uint32_t>(i));
  }
  return first;
}

std::vector<Eigen::Vector3f> ThinPoints(std::span<const Eigen::Vector3f> points,
                                        double cube_size_m) {
  std::vector<Eigen::Vector3f> thinned;
  for (const std::uint32_t i : FirstPointPerCube(points, cube_size_m)) {
    thinned.push_back(points[i]);
  }
  return thinned;
}

}  // namespace soundmap::mapping
