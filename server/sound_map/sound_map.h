#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sound_map/config.h"
#include "sound_map/evidence.h"
#include "sound_map/snapshot.h"
#include "sound_map/tile_blob.h"

namespace soundmap::sound_map {

// The live sound map of one region, section V. One writer at a time calls the functions that are
// not const; any thread may ask for a snapshot. The result depends on nothing but the order of the
// scans.
class SoundMap {
 public:
  // InvalidArgument as SoundMapConfig::Validate().
  static absl::StatusOr<std::unique_ptr<SoundMap>> Create(const SoundMapConfig& config);
  ~SoundMap();

  const SoundMapConfig& config() const { return config_; }

  // Adds one scan's evidence, each end point in turn. InvalidArgument, and no change, when a
  // likelihood is not inside (0, 1).
  absl::Status Apply(const EvidenceScan& evidence);

  // A scan of another map that shares this one's count of revisions: nothing else changes.
  void Skip();

  // The map after the last whole scan: the same object until the next one. Costs a pointer a tile,
  // during which a writer waits; the writer then copies each 8^3 block of this view once before it
  // changes it. Ask for what is shown, not at every scan.
  std::shared_ptr<const Snapshot> TakeSnapshot() const;

  // The same for the writer itself, who lets go of it before it changes the map again: nothing is
  // copied for it.
  Snapshot Present() const;

  // Those of TakeSnapshot().
  std::uint64_t revision() const;
  std::optional<frames::TimeNs> as_of_ns() const;

  // The tiles that changed since the last call, by key, for a checkpoint. When the checkpoint
  // fails, give their keys to MarkDirty().
  std::vector<TileBlob> TakeDirtyTiles();
  void MarkDirty(std::span<const TileKey> keys);

  // Puts a tile back as it was saved, in place of what stands there; it is not dirty. DataLoss or
  // InvalidArgument as ParseTile().
  absl::Status Load(const TileBlob& blob);
  // After the tiles are loaded: the counters of the map as they were at the checkpoint.
  void Restore(std::uint64_t revision, std::optional<frames::TimeNs> as_of_ns);

  // Heap that the present map holds; what only snapshots still hold is not in it.
  std::size_t MemoryBytes() const;

 private:
  struct Entry {
    std::shared_ptr<Tile> tile;
    bool dirty = false;
  };

  explicit SoundMap(const SoundMapConfig& config) : config_(config) {}
  // Both with mutex_ held.
  Snapshot View() const;
  Tile* OpenTile(const TileKey& key);

  const SoundMapConfig config_;
  mutable std::mutex mutex_;  // guards what follows
  std::map<TileKey, Entry> tiles_;
  std::uint64_t revision_ = 0;
  std::optional<frames::TimeNs> as_of_ns_;
  mutable std::uint64_t generation_ = 1;
  mutable std::weak_ptr<const Snapshot> snapshot_;  // of the present state; readers own it
};

}  // namespace soundmap::sound_map
