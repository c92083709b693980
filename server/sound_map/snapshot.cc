#include "sound_map/snapshot.h"

#include <algorithm>

#include "sound_map/tile.h"

namespace soundmap::sound_map {

Snapshot::Snapshot(double voxel_size_m, std::uint64_t revision,
                   std::optional<frames::TimeNs> as_of_ns, Tiles tiles)
    : voxel_size_m_(voxel_size_m),
      revision_(revision),
      as_of_ns_(as_of_ns),
      tiles_(std::move(tiles)) {
  for (const auto& tile : tiles_) voxel_count_ += tile->voxel_count();
}

const Tile* Snapshot::FindTile(const TileKey& key) const {
  const auto found = std::lower_bound(
      tiles_.begin(), tiles_.end(), key,
      [](const auto& tile, const TileKey& wanted) { return tile->key() < wanted; });
  return found != tiles_.end() && (*found)->key() == key ? found->get() : nullptr;
}

std::optional<std::uint64_t> Snapshot::TileRevision(const TileKey& key) const {
  const Tile* tile = FindTile(key);
  return tile == nullptr ? std::nullopt : std::optional(tile->revision());
}

std::optional<Voxel> Snapshot::Find(const geometry::VoxelKey& key) const {
  const Tile* tile = FindTile(TileOf(key));
  return tile == nullptr ? std::nullopt : tile->Find(key);
}

std::optional<Support> Snapshot::FindSupport(const geometry::VoxelKey& key) const {
  const Tile* tile = FindTile(TileOf(key));
  if (tile == nullptr) return std::nullopt;
  const auto found = tile->support().find(
      static_cast<std::uint16_t>(Tile::BlockOf(key) * Block::kVoxels + Tile::VoxelOf(key)));
  return found == tile->support().end() ? std::nullopt : std::optional(found->second);
}

bool Snapshot::ForEach(Visitor visit) const {
  return std::all_of(tiles_.begin(), tiles_.end(),
                     [&](const auto& tile) { return tile->ForEach(visit); });
}

bool Snapshot::ForEachInBox(const geometry::VoxelKey& min, const geometry::VoxelKey& max,
                            Visitor visit) const {
  const auto overlaps = [&](const geometry::VoxelKey& corner, int size) {
    return corner.x <= max.x && corner.y <= max.y && corner.z <= max.z && corner.x + size > min.x &&
           corner.y + size > min.y && corner.z + size > min.z;
  };
  const auto inside = [&](const geometry::VoxelKey& key) {
    return key.x >= min.x && key.y >= min.y && key.z >= min.z && key.x <= max.x && key.y <= max.y &&
           key.z <= max.z;
  };
  const TileKey first = TileOf(min);
  const TileKey last = TileOf(max);
  auto tile = std::lower_bound(
      tiles_.begin(), tiles_.end(), first,
      [](const auto& entry, const TileKey& wanted) { return entry->key().x < wanted.x; });
  for (; tile != tiles_.end() && (*tile)->key().x <= last.x; ++tile) {
    if (!overlaps((*tile)->KeyOf(0, 0), 1 << TileKey::kBits)) continue;
    for (int b = 0; b < Tile::kBlocks; ++b) {
      const Block* block = (*tile)->block(b);
      if (block == nullptr || !overlaps((*tile)->KeyOf(b, 0), 1 << Block::kBits)) continue;
      int rank = 0;
      for (int word = 0; word < 8; ++word) {
        for (std::uint64_t rest = block->mask()[word]; rest != 0; rest &= rest - 1, ++rank) {
          const geometry::VoxelKey key = (*tile)->KeyOf(b, word * 64 + __builtin_ctzll(rest));
          if (inside(key) && !visit(key, (*tile)->VoxelAt(*block, rank))) return false;
        }
      }
    }
  }
  return true;
}

}  // namespace soundmap::sound_map
