#pragma once

#include <Eigen/Core>
#include <bitset>
#include <boost/unordered/unordered_flat_map.hpp>
#include <functional>
#include <memory>

#include "geometry/voxel_key.h"

namespace octomap {
class OcTree;
}

namespace soundmap::building {

// The part of a building's air where nothing stood when it was mapped. What is met there is on its
// way: a person, another robot. Immutable; any number of threads.
class FreeSpace {
 public:
  // Nearer than this to what the map knows, a point may lie on it: the map is in voxels, the robot
  // does not know exactly where it is, and the LIDAR sees a slanting surface at angles of its own.
  static constexpr double kMargin_m = 0.3;

  explicit FreeSpace(std::shared_ptr<const octomap::OcTree> octree);

  // Whether the map knows the point to be free, and nothing occupied within about kMargin_m.
  bool Contains(const Eigen::Vector3d& point_in_map_m) const;

 private:
  using Block = std::bitset<512>;  // 8^3 cells

  std::shared_ptr<const octomap::OcTree> octree_;
  // The cells within the margin of something occupied.
  boost::unordered_flat_map<geometry::VoxelKey, Block, std::hash<geometry::VoxelKey>> near_;
};

}  // namespace soundmap::building
