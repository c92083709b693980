#include "sound_map/support_field.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "sound_map/tile.h"

namespace soundmap::sound_map {
namespace {

geometry::VoxelKey BlockKeyOf(const geometry::VoxelKey& key) {
  return {static_cast<std::uint16_t>(key.x >> Block::kBits),
          static_cast<std::uint16_t>(key.y >> Block::kBits),
          static_cast<std::uint16_t>(key.z >> Block::kBits)};
}

geometry::VoxelKey Clamped(int x, int y, int z) {
  const auto part = [](int value) {
    return static_cast<std::uint16_t>(std::clamp(value, 0, 65535));
  };
  return {part(x), part(y), part(z)};
}

}  // namespace

std::vector<ObservedVoxel> FindSupportedVoxels(const Snapshot& snapshot,
                                               std::uint32_t min_updates) {
  std::vector<ObservedVoxel> voxels;
  std::vector<std::pair<std::uint16_t, Support>> heard;
  for (const auto& tile : snapshot.tiles()) {
    heard.assign(tile->support().begin(), tile->support().end());
    std::sort(heard.begin(), heard.end(),
              [](const auto& a, const auto& b) { return a.first < b.first; });
    for (const auto& [number, support] : heard) {
      const geometry::VoxelKey key = tile->KeyOf(number / Block::kVoxels, number % Block::kVoxels);
      const std::optional<Voxel> voxel = tile->Find(key);
      if (voxel && voxel->update_count > min_updates) voxels.push_back({key, *voxel, support});
    }
  }
  return voxels;
}

SupportField::SupportField(const Snapshot& snapshot, std::vector<ObservedVoxel> supported)
    : snapshot_(snapshot), voxels_(std::move(supported)) {
  for (int i = 0; i < static_cast<int>(voxels_.size()); ++i) {
    const auto [entry, is_new] = blocks_.try_emplace(BlockKeyOf(voxels_[i].key), Range{i, i});
    entry->second.end = i + 1;
  }
}

std::vector<const ObservedVoxel*> SupportField::Around(const Eigen::Vector3d& point_in_map,
                                                       double radius_m) const {
  std::vector<const ObservedVoxel*> found;
  const auto low = geometry::KeyFromPoint(point_in_map.array() - radius_m, voxel_size_m());
  const auto high = geometry::KeyFromPoint(point_in_map.array() + radius_m, voxel_size_m());
  if (!low || !high) return found;
  const geometry::VoxelKey first = BlockKeyOf(*low);
  const geometry::VoxelKey last = BlockKeyOf(*high);
  for (int z = first.z; z <= last.z; ++z) {
    for (int y = first.y; y <= last.y; ++y) {
      for (int x = first.x; x <= last.x; ++x) {
        const auto block = blocks_.find(Clamped(x, y, z));
        if (block == blocks_.end()) continue;
        for (int i = block->second.begin; i < block->second.end; ++i) {
          const Eigen::Vector3d centre = geometry::PointFromKey(voxels_[i].key, voxel_size_m());
          if ((centre - point_in_map).norm() <= radius_m) found.push_back(&voxels_[i]);
        }
      }
    }
  }
  return found;
}

void SupportField::ForEachCount(
    double sigma_m, double min_share,
    absl::FunctionRef<void(const ObservedVoxel&, const Counts&)> visit) const {
  const double sigma = sigma_m / voxel_size_m();
  const int radius = static_cast<int>(std::ceil(2.5 * sigma));
  std::vector<float> kernel(radius + 1);
  for (int k = 0; k <= radius; ++k) {
    kernel[k] = static_cast<float>(std::exp(-0.5 * k * k / (sigma * sigma)));
  }
  struct Neighbour {
    int x, y, z;
    float all;
    float supporting;
  };
  const auto stands_out = [min_share](const ObservedVoxel& voxel) {
    return voxel.support.count > 1 && voxel.support.count > min_share * voxel.fields.update_count;
  };
  std::vector<Neighbour> neighbours;
  const int count = static_cast<int>(voxels_.size());
  for (int begin = 0, end = 0; begin < count; begin = end) {
    const Range block = blocks_.find(BlockKeyOf(voxels_[begin].key))->second;
    end = block.end;
    if (std::none_of(voxels_.begin() + begin, voxels_.begin() + end, stands_out)) {
      continue;
    }
    // All that the Gaussians of this block's voxels reach: first every voxel's observations, then
    // which of them supported.
    const geometry::VoxelKey& key = voxels_[begin].key;
    const geometry::VoxelKey low =
        Clamped((key.x & ~7) - radius, (key.y & ~7) - radius, (key.z & ~7) - radius);
    const geometry::VoxelKey high =
        Clamped((key.x | 7) + radius, (key.y | 7) + radius, (key.z | 7) + radius);
    neighbours.clear();
    snapshot_.ForEachInBox(low, high, [&](const geometry::VoxelKey& near, const Voxel& voxel) {
      neighbours.push_back({near.x, near.y, near.z, static_cast<float>(voxel.update_count), 0.0f});
      return true;
    });
    for (int z = low.z >> 3; z <= high.z >> 3; ++z) {
      for (int y = low.y >> 3; y <= high.y >> 3; ++y) {
        for (int x = low.x >> 3; x <= high.x >> 3; ++x) {
          const auto near = blocks_.find(Clamped(x, y, z));
          if (near == blocks_.end()) continue;
          for (int i = near->second.begin; i < near->second.end; ++i) {
            neighbours.push_back({voxels_[i].key.x, voxels_[i].key.y, voxels_[i].key.z, 0.0f,
                                  static_cast<float>(voxels_[i].support.count)});
          }
        }
      }
    }
    for (int i = begin; i < end; ++i) {
      const ObservedVoxel& voxel = voxels_[i];
      if (!stands_out(voxel)) continue;
      Counts counts;
      for (const Neighbour& neighbour : neighbours) {
        const int dx = std::abs(neighbour.x - voxel.key.x);
        const int dy = std::abs(neighbour.y - voxel.key.y);
        const int dz = std::abs(neighbour.z - voxel.key.z);
        if (dx > radius || dy > radius || dz > radius) continue;
        const double weight = static_cast<double>(kernel[dx] * kernel[dy]) * kernel[dz];
        counts.supporting += weight * neighbour.supporting;
        counts.all += weight * neighbour.all;
      }
      visit(voxel, counts);
    }
  }
}

}  // namespace soundmap::sound_map
