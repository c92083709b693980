#include "pipeline/region.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "pipeline/archive.h"
#include "sound_map/sound_sources.h"

namespace soundmap::pipeline {
namespace {

// Voxel updates in the journal behind the checkpoint, at most: some seconds of replay after a
// crash.
constexpr std::int64_t kCheckpointUpdates = 20'000'000;

}  // namespace

// The sound map of one band and its sources.
struct Region::BandMap {
  explicit BandMap(std::unique_ptr<sound_map::SoundMap> empty)
      : map(std::move(empty)),
        source_register(map->config()),
        finder(map->config().sources),
        preview_finder(map->config().sources) {}

  const std::unique_ptr<sound_map::SoundMap> map;  // changed with writer_mutex_ held
  sound_map::SourceRegister source_register;       // guarded by writer_mutex_
  sound_map::SourceFinder finder;                  // guarded by writer_mutex_
  std::shared_ptr<const Sources> published;        // guarded by finding_mutex_
  sound_map::SourceFinder preview_finder;          // guarded by finding_mutex_
  std::shared_ptr<const Sources> sources;  // guarded by sources_mutex_; never null once open
};

Region::Region(std::string site, storage::Store* store,
               std::vector<std::unique_ptr<sound_map::SoundMap>> maps)
    : site_(std::move(site)), store_(store), bands_([&maps] {
        std::vector<std::unique_ptr<BandMap>> bands;
        for (auto& map : maps) bands.push_back(std::make_unique<BandMap>(std::move(map)));
        return bands;
      }()) {}

Region::~Region() = default;

absl::StatusOr<std::unique_ptr<Region>> Region::Open(const std::string& site, storage::Store* store,
                                                     const sound_map::SoundMapConfig& config,
                                                     std::size_t band_count) {
  std::vector<std::unique_ptr<sound_map::SoundMap>> maps;
  for (std::size_t band = 0; band < band_count; ++band) {
    auto map = sound_map::SoundMap::Create(config);
    if (!map.ok()) return map.status();
    maps.push_back(*std::move(map));
  }
  std::unique_ptr<Region> region(new Region(site, store, std::move(maps)));
  const absl::Status loaded = region->Load();
  if (!loaded.ok()) return loaded;
  region->PublishSourceChanges();  // what is known from the start is no event
  return region;
}

absl::Status Region::CheckBand(std::size_t band) const {
  if (band < bands_.size()) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat("there is evidence of band ", band, " of site ", site_,
                                          ", which has none such"));
}

absl::Status Region::LoadTiles() {
  const auto checkpoint =
      store_->ReadTiles(site_, [this](const storage::Tile& tile) -> absl::Status {
        const absl::Status known = CheckBand(tile.key.band);
        if (!known.ok()) return known;
        return bands_[tile.key.band]->map->Load({{tile.key.x, tile.key.y, tile.key.z}, tile.bytes});
      });
  if (!checkpoint.ok()) return checkpoint.status();
  sequence_ = *checkpoint;
  for (const auto& band : bands_) {
    // Every journal entry has an end point, so that the newest evidence is the newest update of a
    // voxel.
    std::optional<frames::TimeNs> as_of_ns;
    band->map->TakeSnapshot()->ForEach(
        [&](const geometry::VoxelKey&, const sound_map::Voxel& voxel) {
          as_of_ns = std::max(as_of_ns.value_or(voxel.last_update_ns), voxel.last_update_ns);
          return true;
        });
    band->map->Restore(sequence_, as_of_ns);
  }
  return absl::OkStatus();
}

absl::Status Region::Load() {
  const auto stored = store_->ReadSourceRegister(site_);
  if (!stored.ok()) return stored.status();
  if (auto registers = DecodeSourceRegisters(*stored);
      registers.ok() && registers->size() == bands_.size()) {
    for (std::size_t band = 0; band < bands_.size(); ++band) {
      bands_[band]->source_register.Restore(std::move((*registers)[band]));
    }
    const absl::Status loaded = LoadTiles();
    if (!loaded.ok()) return loaded;
  }
  StageClock unmeasured(nullptr);
  return store_->ReadJournal(
      site_, sequence_ + 1,
      [this, &unmeasured](const storage::JournalRecord& record) -> absl::Status {
        const auto scan = DecodeAudioScan(record.entry.summary);
        if (!scan.ok()) return scan.status();
        const absl::Status known = CheckBand(scan->band);
        if (!known.ok()) return known;
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

std::shared_ptr<const sound_map::Snapshot> Region::snapshot(std::uint8_t band) const {
  return bands_[band]->map->TakeSnapshot();
}

std::uint64_t Region::revision() const { return bands_[kMainBand]->map->revision(); }

absl::StatusOr<std::vector<sound_map::SourceEvent>> Region::Apply(
    const sound_map::EvidenceScan& evidence, const AudioScanInfo& scan, StageClock& clock) {
  BandMap& band = *bands_[scan.band];
  const absl::Status applied = band.map->Apply(evidence);
  if (applied.ok()) {
    for (const auto& other : bands_) {
      if (other.get() != &band) other->map->Skip();
    }
  }
  clock.Lap(Stage::kMap);
  if (!applied.ok()) return applied;
  band.source_register.Observe({scan.robot,
                                {scan.pose.map_from_base.x_m, scan.pose.map_from_base.y_m},
                                &evidence,
                                &scan.heard,
                                scan.array_plane,
                                scan.full_scale_spl_db,
                                scan.array_in_map_m});
  std::vector<sound_map::SourceEvent> events;
  if (band.source_register.due()) {
    events = band.source_register.Update(band.finder.Find(band.map->Present()));
  }
  clock.Lap(Stage::kSources);
  return events;
}

std::shared_ptr<const Region::Sources> Region::sources(std::uint8_t band) const {
  std::lock_guard lock(sources_mutex_);
  return bands_[band]->sources;
}

void Region::Tell(BandMap& band, std::shared_ptr<const Sources> sources) {
  std::lock_guard lock(sources_mutex_);
  if (!band.sources || band.sources->revision < sources->revision) {
    band.sources = std::move(sources);
  }
}

void Region::FindSources() {
  std::lock_guard lock(finding_mutex_);
  for (const auto& band : bands_) FindSourcesLocked(*band);
}

void Region::FindSourcesLocked(BandMap& band) {
  // Between two updates of the register, what the next one would say if it came now.
  std::optional<sound_map::SourceRegister> preview;
  std::shared_ptr<const sound_map::Snapshot> map;
  {
    std::lock_guard lock(writer_mutex_);
    std::lock_guard sources_lock(sources_mutex_);
    if (band.sources && band.sources->revision == sequence_) return;
    preview = band.source_register;
    map = band.map->TakeSnapshot();
  }
  if (preview->pending()) preview->Update(band.preview_finder.Find(*map));
  Tell(band, std::make_shared<const Sources>(
                 Sources{preview->Sources(), map->revision(), map->as_of_ns()}));
}

void Region::PublishSourceChanges() {
  std::lock_guard lock(finding_mutex_);
  for (std::size_t band = 0; band < bands_.size(); ++band) {
    PublishSourceChangesLocked(static_cast<std::uint8_t>(band));
  }
}

void Region::PublishSourceChangesLocked(std::uint8_t number) {
  BandMap& band = *bands_[number];
  if (!sources(number)) FindSourcesLocked(band);
  const std::shared_ptr<const Sources> now = sources(number);
  const std::shared_ptr<const Sources> before = std::exchange(band.published, now);
  if (!before || before->revision == now->revision) return;
  std::map<std::uint64_t, const sound_map::RegisteredSource*> removed;
  for (const auto& source : before->sources) removed[source.found.id] = &source;
  for (const auto& source : now->sources) {
    const auto known = removed.find(source.found.id);
    if (known == removed.end() || !(*known->second == source)) {
      events_.Publish(SourceChanged{number, source});
    }
    if (known != removed.end()) removed.erase(known);
  }
  for (const auto& [id, source] : removed) events_.Publish(SourceRemoved{number, id});
}

absl::Status Region::Commit(const storage::Commit& commit, StageClock& clock) {
  std::vector<AudioScanInfo> scans;
  for (const storage::JournalEntry& entry : commit.journal) {
    auto scan = DecodeAudioScan(entry.summary);
    if (!scan.ok()) return scan.status();
    const absl::Status known = CheckBand(scan->band);
    if (!known.ok()) return absl::InvalidArgumentError(known.message());
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
  std::vector<SourceHappened> events;
  std::map<BandMap*, std::shared_ptr<const Sources>> updated;
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const sound_map::EvidenceScan& evidence = commit.journal[i].evidence;
    auto happened = Apply(evidence, scans[i], clock);
    if (!happened.ok()) return happened.status();
    for (sound_map::SourceEvent& event : *happened) {
      events.push_back({scans[i].band, std::move(event)});
    }
    BandMap& band = *bands_[scans[i].band];
    if (!band.source_register.pending()) {
      // Just updated; looking for sources more often than this would cost more than it tells.
      updated[&band] = std::make_shared<const Sources>(
          Sources{band.source_register.Sources(), band.map->revision(), band.map->as_of_ns()});
    }
    updates_since_checkpoint_ += static_cast<std::int64_t>(evidence.end_points.size());
  }
  for (auto& [band, sources] : updated) Tell(*band, std::move(sources));
  for (AudioScanInfo& scan : scans) events_.Publish(std::move(scan));
  for (SourceHappened& event : events) events_.Publish(std::move(event));
  // A checkpoint that fails is tried again after the next commit; the journal has everything.
  if (updates_since_checkpoint_ >= kCheckpointUpdates) CheckpointLocked().IgnoreError();
  return absl::OkStatus();
}

absl::Status Region::Checkpoint() {
  std::lock_guard lock(writer_mutex_);
  return CheckpointLocked();
}

absl::Status Region::CheckpointLocked() {
  std::vector<storage::Tile> tiles;
  std::vector<std::vector<sound_map::TileKey>> keys(bands_.size());
  SourceRegisters registers;
  for (std::size_t band = 0; band < bands_.size(); ++band) {
    for (sound_map::TileBlob& blob : bands_[band]->map->TakeDirtyTiles()) {
      keys[band].push_back(blob.key);
      tiles.push_back({{blob.key.x, blob.key.y, blob.key.z, static_cast<std::uint8_t>(band)},
                       std::move(blob.bytes)});
    }
    registers.push_back(bands_[band]->source_register.state());
  }
  if (tiles.empty()) return absl::OkStatus();
  const absl::Status stored =
      store_->PutCheckpoint(site_, tiles, sequence_, EncodeSourceRegisters(registers));
  if (!stored.ok()) {
    for (std::size_t band = 0; band < bands_.size(); ++band) {
      bands_[band]->map->MarkDirty(keys[band]);
    }
    return stored;
  }
  updates_since_checkpoint_ = 0;
  return absl::OkStatus();
}

}  // namespace soundmap::pipeline
