#include "pipeline/region.h"

#include <algorithm>
#include <map>
#include <utility>

#include "pipeline/archive.h"

namespace soundmap::pipeline {
namespace {

// Voxel updates in the journal behind the checkpoint, at most: some seconds of replay after a
// crash.
constexpr std::int64_t kCheckpointUpdates = 20'000'000;

}  // namespace

absl::StatusOr<std::unique_ptr<Region>> Region::Open(const std::string& site, storage::Store* store,
                                                     const sound_map::SoundMapConfig& config) {
  auto map = sound_map::SoundMap::Create(config);
  if (!map.ok()) return map.status();
  std::unique_ptr<Region> region(new Region(site, store, *std::move(map)));
  const absl::Status loaded = region->Load();
  if (!loaded.ok()) return loaded;
  region->PublishSourceChanges();  // what is known from the start is no event
  return region;
}

absl::Status Region::Load() {
  const auto checkpoint = store_->ReadTiles(site_, [this](const storage::Tile& tile) {
    return map_->Load({{tile.key.x, tile.key.y, tile.key.z}, tile.bytes});
  });
  if (!checkpoint.ok()) return checkpoint.status();
  sequence_ = *checkpoint;
  // Every journal entry has an end point, so that the newest evidence is the newest update of a
  // voxel.
  std::optional<frames::TimeNs> as_of_ns;
  map_->TakeSnapshot()->ForEach([&](const geometry::VoxelKey&, const sound_map::Voxel& voxel) {
    as_of_ns = std::max(as_of_ns.value_or(voxel.last_update_ns), voxel.last_update_ns);
    return true;
  });
  map_->Restore(sequence_, as_of_ns);
  return store_->ReadJournal(site_, sequence_ + 1, [this](const storage::JournalRecord& record) {
    sequence_ = record.sequence;
    updates_since_checkpoint_ += static_cast<std::int64_t>(record.entry.evidence.end_points.size());
    return map_->Apply(record.entry.evidence);
  });
}

std::shared_ptr<const Region::Sources> Region::sources() const {
  std::lock_guard lock(sources_mutex_);
  return sources_;
}

void Region::FindSources() {
  std::lock_guard lock(finding_mutex_);
  FindSourcesLocked();
}

void Region::FindSourcesLocked() {
  const std::shared_ptr<const sound_map::Snapshot> map = snapshot();
  if (const auto known = sources(); known && known->revision == map->revision()) return;
  auto found = std::make_shared<const Sources>(Sources{
      sound_map::FindSoundSources(*map, map_->config().sources), map->revision(), map->as_of_ns()});
  std::lock_guard lock(sources_mutex_);
  sources_ = std::move(found);
}

void Region::PublishSourceChanges() {
  std::lock_guard lock(finding_mutex_);
  FindSourcesLocked();
  const std::shared_ptr<const Sources> now = sources();
  const std::shared_ptr<const Sources> before = std::exchange(published_, now);
  if (!before || before->revision == now->revision) return;
  std::map<std::uint64_t, const sound_map::SoundSource*> gone;
  for (const sound_map::SoundSource& source : before->sources) gone[source.id] = &source;
  for (const sound_map::SoundSource& source : now->sources) {
    const auto known = gone.find(source.id);
    if (known == gone.end() || !(*known->second == source)) events_.Publish(source);
    if (known != gone.end()) gone.erase(known);
  }
  for (const auto& [id, source] : gone) events_.Publish(SourceRemoved{id});
}

absl::Status Region::Commit(const storage::Commit& commit, StageClock& clock) {
  std::vector<AudioScanInfo> scans;
  for (const storage::JournalEntry& entry : commit.journal) {
    auto scan = DecodeAudioScan(entry.summary);
    if (!scan.ok()) return scan.status();
    scan->session = commit.session;
    scan->time_ns = entry.evidence.stamp_ns;
    scans.push_back(*std::move(scan));
  }
  const auto entries = storage::Store::EncodeJournal(commit);
  if (!entries.ok()) return entries.status();
  std::lock_guard lock(writer_mutex_);
  const auto sequence = store_->CommitBatch(commit, *entries);
  if (!sequence.ok()) return sequence.status();
  sequence_ = *sequence;
  clock.Lap(Stage::kCommit);
  for (const storage::JournalEntry& entry : commit.journal) {
    const absl::Status applied = map_->Apply(entry.evidence);
    if (!applied.ok()) return applied;
    updates_since_checkpoint_ += static_cast<std::int64_t>(entry.evidence.end_points.size());
  }
  clock.Lap(Stage::kMap);
  for (AudioScanInfo& scan : scans) events_.Publish(std::move(scan));
  // A checkpoint that fails is tried again after the next commit; the journal has everything.
  if (updates_since_checkpoint_ >= kCheckpointUpdates) CheckpointLocked().IgnoreError();
  return absl::OkStatus();
}

absl::Status Region::Checkpoint() {
  std::lock_guard lock(writer_mutex_);
  return CheckpointLocked();
}

absl::Status Region::CheckpointLocked() {
  std::vector<sound_map::TileBlob> dirty = map_->TakeDirtyTiles();
  if (dirty.empty()) return absl::OkStatus();
  std::vector<storage::Tile> tiles;
  std::vector<sound_map::TileKey> keys;
  tiles.reserve(dirty.size());
  for (sound_map::TileBlob& blob : dirty) {
    keys.push_back(blob.key);
    tiles.push_back({{blob.key.x, blob.key.y, blob.key.z}, std::move(blob.bytes)});
  }
  const absl::Status stored = store_->PutCheckpoint(site_, tiles, sequence_);
  if (!stored.ok()) {
    map_->MarkDirty(keys);
    return stored;
  }
  updates_since_checkpoint_ = 0;
  return absl::OkStatus();
}

}  // namespace soundmap::pipeline
