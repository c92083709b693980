#include "sound_map/sound_map.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "sound_map/tile.h"

namespace soundmap::sound_map {
namespace {

// log(p / (1 - p)) of section V, remembered: a likelihood scan has few distinct values.
class LogOdds {
 public:
  LogOdds() { entries_.fill({0.5f, 0.0f}); }

  float operator()(float likelihood) {
    Entry& entry = entries_[(std::bit_cast<std::uint32_t>(likelihood) * 2654435761u) >> 28];
    if (entry.likelihood != likelihood) {
      const double p = likelihood;
      entry = {likelihood, static_cast<float>(std::log(p / (1.0 - p)))};
    }
    return entry.log_odds;
  }

 private:
  struct Entry {
    float likelihood;
    float log_odds;
  };
  std::array<Entry, 16> entries_;
};

// The tiles of one scan: those of a 12.8 m cube never evict each other.
class TileCache {
 public:
  struct Slot {
    TileKey key;
    std::uint16_t stamp = 0;
    Tile* tile = nullptr;
  };

  Slot& operator[](const TileKey& key) {
    return slots_[(key.x & 7) | (key.y & 7) << 3 | (key.z & 7) << 6];
  }

 private:
  std::array<Slot, 512> slots_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<SoundMap>> SoundMap::Create(const SoundMapConfig& config) {
  if (absl::Status status = config.Validate(); !status.ok()) return status;
  return std::unique_ptr<SoundMap>(new SoundMap(config));
}

SoundMap::~SoundMap() = default;

Tile* SoundMap::OpenTile(const TileKey& key) {
  Entry& entry = tiles_[key];
  if (!entry.tile) {
    entry.tile = std::make_shared<Tile>(key, generation_);
  } else if (entry.tile->generation() != generation_) {
    entry.tile = std::make_shared<Tile>(*entry.tile, generation_);
  }
  entry.dirty = true;
  entry.tile->set_revision(revision_);
  return entry.tile.get();
}

absl::Status SoundMap::Apply(const EvidenceScan& evidence) {
  for (const EndPoint& end_point : evidence.end_points) {
    if (!(end_point.likelihood > 0.0f && end_point.likelihood < 1.0f)) {
      return absl::InvalidArgumentError(absl::StrCat("the likelihood ", end_point.likelihood,
                                                     " of an end point is not inside (0, 1)"));
    }
  }

  LogOdds log_odds_of;
  TileCache cache;
  const float min_log_odds = static_cast<float>(config_.min_log_odds);
  const float max_log_odds = static_cast<float>(config_.max_log_odds);
  const bool freeze = config_.stop_rule == StopRule::kFreeze;

  std::lock_guard lock(mutex_);
  ++revision_;
  as_of_ns_ = as_of_ns_ ? std::max(*as_of_ns_, evidence.stamp_ns) : evidence.stamp_ns;
  snapshot_.reset();
  for (const EndPoint& end_point : evidence.end_points) {
    const TileKey tile_key = TileOf(end_point.key);
    TileCache::Slot& slot = cache[tile_key];
    if (slot.tile == nullptr || slot.key != tile_key) {
      Tile* tile = OpenTile(tile_key);
      slot = {tile_key, tile->AddStamp(evidence.stamp_ns), tile};
    }
    Tile& tile = *slot.tile;
    const int block = Tile::BlockOf(end_point.key);
    const int voxel = Tile::VoxelOf(end_point.key);
    Block::Cell& cell = tile.Touch(block, voxel);

    const float log_odds = cell.log_odds;
    const bool outside = log_odds < min_log_odds || log_odds > max_log_odds;
    if (!(freeze && outside)) {
      const float sum = log_odds + log_odds_of(end_point.likelihood);
      cell.log_odds = freeze ? sum : std::clamp(sum, min_log_odds, max_log_odds);
    }
    const bool is_new = cell.update_count == 0;
    if (cell.update_count != UINT32_MAX) ++cell.update_count;
    if (is_new || tile.stamp(cell.stamp) < evidence.stamp_ns) cell.stamp = slot.stamp;
    if (end_point.likelihood > 0.5f)
      tile.AddSupport(block * Block::kVoxels + voxel, evidence.stamp_ns);
  }
  return absl::OkStatus();
}

void SoundMap::Skip() {
  std::lock_guard lock(mutex_);
  ++revision_;
  snapshot_.reset();
}

Snapshot SoundMap::View() const {
  Snapshot::Tiles tiles;
  tiles.reserve(tiles_.size());
  for (const auto& [key, entry] : tiles_) tiles.push_back(entry.tile);
  return Snapshot(config_.voxel_size_m, revision_, as_of_ns_, std::move(tiles));
}

Snapshot SoundMap::Present() const {
  std::lock_guard lock(mutex_);
  return View();
}

std::shared_ptr<const Snapshot> SoundMap::TakeSnapshot() const {
  std::lock_guard lock(mutex_);
  std::shared_ptr<const Snapshot> snapshot = snapshot_.lock();
  if (!snapshot) {
    snapshot = std::make_shared<const Snapshot>(View());
    snapshot_ = snapshot;
    ++generation_;
  }
  return snapshot;
}

std::uint64_t SoundMap::revision() const {
  std::lock_guard lock(mutex_);
  return revision_;
}

std::optional<frames::TimeNs> SoundMap::as_of_ns() const {
  std::lock_guard lock(mutex_);
  return as_of_ns_;
}

std::vector<TileBlob> SoundMap::TakeDirtyTiles() {
  std::vector<std::shared_ptr<const Tile>> dirty;
  {
    std::lock_guard lock(mutex_);
    for (auto& [key, entry] : tiles_) {
      if (!entry.dirty) continue;
      dirty.push_back(entry.tile);
      entry.dirty = false;
    }
    if (!dirty.empty()) ++generation_;
  }
  std::vector<TileBlob> blobs;
  blobs.reserve(dirty.size());
  for (const auto& tile : dirty) {
    blobs.push_back({tile->key(), SerializeTile(*tile, config_.voxel_size_m)});
  }
  return blobs;
}

void SoundMap::MarkDirty(std::span<const TileKey> keys) {
  std::lock_guard lock(mutex_);
  for (const TileKey& key : keys) {
    const auto found = tiles_.find(key);
    if (found != tiles_.end()) found->second.dirty = true;
  }
}

absl::Status SoundMap::Load(const TileBlob& blob) {
  auto tile = ParseTile(blob, config_.voxel_size_m);
  if (!tile.ok()) return tile.status();
  std::lock_guard lock(mutex_);
  revision_ = std::max(revision_, (*tile)->revision());
  (*tile)->ForEach([&](const geometry::VoxelKey&, const Voxel& voxel) {
    as_of_ns_ = as_of_ns_ ? std::max(*as_of_ns_, voxel.last_update_ns) : voxel.last_update_ns;
    return true;
  });
  tiles_[blob.key] = {*std::move(tile), /*dirty=*/false};
  snapshot_.reset();
  return absl::OkStatus();
}

void SoundMap::Restore(std::uint64_t revision, std::optional<frames::TimeNs> as_of_ns) {
  std::lock_guard lock(mutex_);
  revision_ = revision;
  as_of_ns_ = as_of_ns;
  snapshot_.reset();
}

std::size_t SoundMap::MemoryBytes() const {
  std::lock_guard lock(mutex_);
  std::size_t bytes = sizeof(SoundMap);
  for (const auto& [key, entry] : tiles_) {
    bytes +=
        entry.tile->memory_bytes() + sizeof(key) + sizeof(entry) + 32;  // 32: a node of the map
  }
  return bytes;
}

}  // namespace soundmap::sound_map
