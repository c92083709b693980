#include "building/free_space.h"

#include <octomap/OcTree.h>

#include <cmath>
#include <set>
#include <utility>
#include <vector>

namespace soundmap::building {
namespace {

constexpr double kCell_m = 0.1;

using geometry::VoxelKey;

VoxelKey BlockOf(const VoxelKey& cell) {
  return {static_cast<std::uint16_t>(cell.x >> 3), static_cast<std::uint16_t>(cell.y >> 3),
          static_cast<std::uint16_t>(cell.z >> 3)};
}

std::size_t PlaceInBlock(const VoxelKey& cell) {
  return static_cast<std::size_t>((cell.z & 7) << 6 | (cell.y & 7) << 3 | (cell.x & 7));
}

// The cells that occupied voxels reach into.
std::set<VoxelKey> OccupiedCells(const octomap::OcTree& octree) {
  std::set<VoxelKey> cells;
  for (auto leaf = octree.begin_leafs(), end = octree.end_leafs(); leaf != end; ++leaf) {
    if (!octree.isNodeOccupied(*leaf)) continue;
    const Eigen::Vector3d centre(leaf.getX(), leaf.getY(), leaf.getZ());
    // Short of the faces, which belong to the neighbours.
    const double half_m = 0.499 * leaf.getSize();
    const auto low = geometry::KeyFromPoint(centre.array() - half_m, kCell_m);
    const auto high = geometry::KeyFromPoint(centre.array() + half_m, kCell_m);
    if (!low || !high) continue;
    for (int z = low->z; z <= high->z; ++z) {
      for (int y = low->y; y <= high->y; ++y) {
        for (int x = low->x; x <= high->x; ++x) {
          cells.insert({static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y),
                        static_cast<std::uint16_t>(z)});
        }
      }
    }
  }
  return cells;
}

}  // namespace

FreeSpace::FreeSpace(std::shared_ptr<const octomap::OcTree> octree) : octree_(std::move(octree)) {
  const int reach = static_cast<int>(std::ceil(kMargin_m / kCell_m));
  std::vector<Eigen::Vector3i> ball;
  for (int z = -reach; z <= reach; ++z) {
    for (int y = -reach; y <= reach; ++y) {
      for (int x = -reach; x <= reach; ++x) {
        const Eigen::Vector3i step(x, y, z);
        if (kCell_m * step.cast<double>().norm() <= kMargin_m + 1e-9) ball.push_back(step);
      }
    }
  }
  for (const VoxelKey& cell : OccupiedCells(*octree_)) {
    for (const Eigen::Vector3i& step : ball) {
      const VoxelKey near{static_cast<std::uint16_t>(cell.x + step.x()),
                          static_cast<std::uint16_t>(cell.y + step.y()),
                          static_cast<std::uint16_t>(cell.z + step.z())};
      near_[BlockOf(near)].set(PlaceInBlock(near));
    }
  }
}

bool FreeSpace::Contains(const Eigen::Vector3d& point_in_map_m) const {
  const auto cell = geometry::KeyFromPoint(point_in_map_m, kCell_m);
  if (!cell) return false;
  const auto block = near_.find(BlockOf(*cell));
  if (block != near_.end() && block->second.test(PlaceInBlock(*cell))) return false;
  const octomap::OcTreeNode* node =
      octree_->search(point_in_map_m.x(), point_in_map_m.y(), point_in_map_m.z());
  return node != nullptr && !octree_->isNodeOccupied(node);
}

}  // namespace soundmap::building
