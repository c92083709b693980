#include "sound_map/place_index.h"

#include <utility>

namespace soundmap::sound_map {

void PlaceIndex::Set(std::vector<Eigen::Vector3d> places_in_map_m) {
  places_in_map_m_ = std::move(places_in_map_m);
  filter_.reset();
  places_of_block_.clear();
  for (int i = 0; i < static_cast<int>(places_in_map_m_.size()); ++i) {
    const Eigen::Vector3d& place = places_in_map_m_[i];
    const auto low = geometry::KeyFromPoint(place.array() - radius_m_, voxel_size_m_);
    const auto high = geometry::KeyFromPoint(place.array() + radius_m_, voxel_size_m_);
    if (!low || !high) continue;
    const geometry::VoxelKey first = BlockOf(*low);
    const geometry::VoxelKey last = BlockOf(*high);
    for (std::uint16_t z = first.z; z <= last.z; ++z) {
      for (std::uint16_t y = first.y; y <= last.y; ++y) {
        for (std::uint16_t x = first.x; x <= last.x; ++x) {
          const geometry::VoxelKey block{x, y, z};
          filter_.set(FilterBit(block));
          places_of_block_[block].push_back(i);
        }
      }
    }
  }
}

std::optional<int> PlaceIndex::Nearest(const geometry::VoxelKey& key) const {
  const auto near = places_of_block_.find(BlockOf(key));
  if (near == places_of_block_.end()) return std::nullopt;
  const Eigen::Vector3d point = geometry::PointFromKey(key, voxel_size_m_);
  std::optional<int> nearest;
  double nearest_m2 = radius_m_ * radius_m_;
  for (const int i : near->second) {
    const double distance_m2 = (places_in_map_m_[i] - point).squaredNorm();
    if (distance_m2 > nearest_m2) continue;
    nearest = i;
    nearest_m2 = distance_m2;
  }
  return nearest;
}

}  // namespace soundmap::sound_map
