#include "pipeline/region.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
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
  const auto stored = store_->ReadSourceRegister(site_);
  if (!stored.ok()) return stored.status();
  if (auto state = DecodeSourceRegister(*stored); state.ok()) {
    register_.Restore(*std::move(state));
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
  }
  StageClock unmeasured(nullptr);
  return store_->ReadJournal(
      site_, sequence_ + 1,
      [this, &unmeasured](const storage::JournalRecord& record) -> absl::Status {
        const auto scan = DecodeAudioScan(record.entry.summary);
        if (!scan.ok()) return scan.status();
        if (record.sequence != sequence_ + 1) {
          return absl::DataLossError(
              absl::StrCat("the journal of site ", site_, " has no entry ", sequence_ + 1));
        }
        sequence_ = record.sequence;
        updates_since_checkpoint_ +=
            static_cast<std::int64_t>(record.entry.evidence.end_points.size());
        return Apply(record.entry.evidence, *scan, unmeasured).status();
      });
}

absl::StatusOr<std::vector<sound_map::SourceEvent>> Region::Apply(
    const sound_map::EvidenceScan& evidence, const AudioScanInfo& scan, StageClock& clock) {
  const absl::Status applied = map_->Apply(evidence);
  clock.Lap(Stage::kMap);
  if (!applied.ok()) return applied;
  register_.Observe({scan.robot,
                     {scan.pose.map_from_base.x_m, scan.pose.map_from_base.y_m},
                     &evidence,
                     &scan.heard,
                     scan.array_plane,
                     scan.full_scale_spl_db});
  std::vector<sound_map::SourceEvent> events;
  if (register_.due()) events = register_.Update(finder_.Find(map_->Present()));
  clock.Lap(Stage::kSources);
  return events;
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
  // Between two updates of the register, what the next one would say if it came now.
  std::optional<sound_map::SourceRegister> preview;
  std::shared_ptr<const sound_map::Snapshot> map;
  {
    std::lock_guard lock(writer_mutex_);
    if (const auto known = sources(); known && known->revision == sequence_) return;
    preview = register_;
    map = snapshot();
  }
  if (preview->pending()) preview->Update(preview_finder_.Find(*map));
  auto found = std::make_shared<const Sources>(
      Sources{preview->Sources(), map->revision(), map->as_of_ns()});
  std::lock_guard lock(sources_mutex_);
  if (!sources_ || sources_->revision < found->revision) sources_ = std::move(found);
}

void Region::PublishSourceChanges() {
  std::lock_guard lock(finding_mutex_);
  if (!sources()) FindSourcesLocked();
  const std::shared_ptr<const Sources> now = sources();
  const std::shared_ptr<const Sources> before = std::exchange(published_, now);
  if (!before || before->revision == now->revision) return;
  std::map<std::uint64_t, const sound_map::RegisteredSource*> removed;
  for (const auto& source : before->sources) removed[source.found.id] = &source;
  for (const auto& source : now->sources) {
    const auto known = removed.find(source.found.id);
    if (known == removed.end() || !(*known->second == source)) events_.Publish(source);
    if (known != removed.end()) removed.erase(known);
  }
  for (const auto& [id, source] : removed) events_.Publish(SourceRemoved{id});
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
  std::vector<sound_map::SourceEvent> events;
  std::shared_ptr<const Sources> updated;
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const sound_map::EvidenceScan& evidence = commit.journal[i].evidence;
    auto happened = Apply(evidence, scans[i], clock);
    if (!happened.ok()) return happened.status();
    std::move(happened->begin(), happened->end(), std::back_inserter(events));
    if (!register_.pending()) {
      // Just updated; looking for sources more often than this would cost more than it tells.
      updated = std::make_shared<const Sources>(
          Sources{register_.Sources(), map_->revision(), map_->as_of_ns()});
    }
    updates_since_checkpoint_ += static_cast<std::int64_t>(evidence.end_points.size());
  }
  if (updated) {
    std::lock_guard sources_lock(sources_mutex_);
    if (!sources_ || sources_->revision < updated->revision) sources_ = std::move(updated);
  }
  for (AudioScanInfo& scan : scans) events_.Publish(std::move(scan));
  for (sound_map::SourceEvent& event : events) events_.Publish(std::move(event));
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
  const absl::Status stored =
      store_->PutCheckpoint(site_, tiles, sequence_, EncodeSourceRegister(register_.state()));
  if (!stored.ok()) {
    map_->MarkDirty(keys);
    return stored;
  }
  updates_since_checkpoint_ = 0;
  return absl::OkStatus();
}

}  // namespace soundmap::pipeline
