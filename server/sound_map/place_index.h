#pragma once

#include <Eigen/Core>
#include <bitset>
#include <boost/unordered/unordered_flat_map.hpp>
#include <optional>
#include <vector>

#include "geometry/voxel_key.h"

namespace soundmap::sound_map {

// Which of some places a voxel is near. Made for many voxels of which few are near one.
class PlaceIndex {
 public:
  PlaceIndex(double radius_m, double voxel_size_m)
      : radius_m_(radius_m), voxel_size_m_(voxel_size_m) {}

  // One outside the octree is near none.
  void Set(std::vector<Eigen::Vector3d> places_in_map_m);

  // False for most voxels that are near none. Ask first: an empty optional costs as much as all the
  // rest.
  bool MayBeNear(const geometry::VoxelKey& key) const { return filter_[FilterBit(BlockOf(key))]; }
  // Index of the place nearest to the voxel's centre, within the radius; of two that are equally
  // near, the last.
  std::optional<int> Nearest(const geometry::VoxelKey& key) const;

 private:
  // 8^3 voxels.
  static geometry::VoxelKey BlockOf(const geometry::VoxelKey& key) {
    return {static_cast<std::uint16_t>(key.x >> 3), static_cast<std::uint16_t>(key.y >> 3),
            static_cast<std::uint16_t>(key.z >> 3)};
  }
  static std::size_t FilterBit(const geometry::VoxelKey& block) {
    return (block.x & 31u) | (block.y & 31u) << 5 | (block.z & 31u) << 10;
  }

  // Most blocks that no place is near are told from the filter, which repeats every 32 blocks.
  static constexpr std::size_t kFilterBits = 1 << 15;

  double radius_m_;
  double voxel_size_m_;
  std::vector<Eigen::Vector3d> places_in_map_m_;
  std::bitset<kFilterBits> filter_;
  boost::unordered_flat_map<geometry::VoxelKey, std::vector<int>, std::hash<geometry::VoxelKey>>
      places_of_block_;
};

}  // namespace soundmap::sound_map
