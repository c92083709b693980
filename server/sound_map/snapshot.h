#pragma once

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "absl/functional/function_ref.h"
#include "sound_map/voxel.h"

namespace soundmap::sound_map {

class Tile;

// The sound map as it was after one scan. Immutable: any thread may read it for as long as it
// likes.
class Snapshot {
 public:
  // In the order of their keys.
  using Tiles = std::vector<std::shared_ptr<const Tile>>;

  Snapshot(double voxel_size_m, std::uint64_t revision, std::optional<frames::TimeNs> as_of_ns,
           Tiles tiles);

  double voxel_size_m() const { return voxel_size_m_; }
  // Scans applied or skipped so far.
  std::uint64_t revision() const { return revision_; }
  // The latest t_k; none before the first scan.
  std::optional<frames::TimeNs> as_of_ns() const { return as_of_ns_; }
  std::size_t voxel_count() const { return voxel_count_; }
  const Tiles& tiles() const { return tiles_; }

  const Tile* FindTile(const TileKey& key) const;
  // The map's revision when the tile last changed.
  std::optional<std::uint64_t> TileRevision(const TileKey& key) const;
  std::optional<Voxel> Find(const geometry::VoxelKey& key) const;
  std::optional<Support> FindSupport(const geometry::VoxelKey& key) const;

  // Every voxel in map order: by tile, then 8^3 block (x fastest), then voxel (x fastest). Stops
  // when the visitor returns false, and returns whether it did not.
  using Visitor = absl::FunctionRef<bool(const geometry::VoxelKey&, const Voxel&)>;
  bool ForEach(Visitor visit) const;
  // The same for the voxels with min <= key <= max on every axis; tiles and blocks outside cost
  // nothing.
  bool ForEachInBox(const geometry::VoxelKey& min, const geometry::VoxelKey& max,
                    Visitor visit) const;

 private:
  double voxel_size_m_;
  std::uint64_t revision_;
  std::optional<frames::TimeNs> as_of_ns_;
  std::size_t voxel_count_ = 0;
  Tiles tiles_;
};

}  // namespace soundmap::sound_map
