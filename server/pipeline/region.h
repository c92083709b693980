#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "pipeline/events.h"
#include "pipeline/stage_times.h"
#include "sound_map/sound_map.h"
#include "sound_map/source_register.h"
#include "storage/store.h"

namespace soundmap::pipeline {

// The sound maps of one site, one a band, and their sources: one writer at a time, readers on
// immutable snapshots that never wait for it. Evidence of all bands enters one journal first, then
// map and source register of its band; the revision of each map is the number of journal entries of
// the site that it knows of, so that it means the same in all bands and after a restart. Maps and
// sources are functions of the journal up to their revision. `band` is everywhere the number of a
// map, below band_count(). Thread safe.
class Region {
 public:
  // The maps as the store has them: the tiles of the last checkpoint, then the journal behind it.
  // Where the store has no source registers that this version can read, all of the journal.
  // DataLoss: what is stored is of more maps than `band_count`.
  static absl::StatusOr<std::unique_ptr<Region>> Open(const std::string& site,
                                                      storage::Store* store,
                                                      const sound_map::SoundMapConfig& config,
                                                      std::size_t band_count = 1);
  ~Region();

  std::size_t band_count() const { return bands_.size(); }
  std::shared_ptr<const sound_map::Snapshot> snapshot(std::uint8_t band = kMainBand) const;
  // Of the snapshots, at no cost to the writer.
  std::uint64_t revision() const;

  struct Sources {
    std::vector<sound_map::RegisteredSource> sources;  // most probable first
    std::uint64_t revision = 0;
    std::optional<frames::TimeNs> as_of_ns;
  };
  // As of the register's last update, or of FindSources(): never waits for either.
  std::shared_ptr<const Sources> sources(std::uint8_t band = kMainBand) const;

  // Brings the sources() of all bands to the newest revision, where they are not there.
  void FindSources();

  // All of the commit takes effect, in the store and in the maps, or nothing does. `clock` is told
  // where the stages end. InvalidArgument: an entry of a band that the site does not have.
  absl::Status Commit(const storage::Commit& commit, StageClock& clock);

  // Writes the tiles that changed since the last checkpoint.
  absl::Status Checkpoint();

  EventRing& events() { return events_; }

  // Publishes which of the sources() are new, removed or different since the last call. What
  // happened to sources (SourceEvent) is published by Commit().
  void PublishSourceChanges();

 private:
  struct BandMap;

  Region(std::string site, storage::Store* store,
         std::vector<std::unique_ptr<sound_map::SoundMap>> maps);
  absl::Status Load();
  absl::Status LoadTiles();
  absl::Status CheckBand(std::size_t band) const;
  // One journal entry enters map and register of its band.
  absl::StatusOr<std::vector<sound_map::SourceEvent>> Apply(const sound_map::EvidenceScan& evidence,
                                                            const AudioScanInfo& scan,
                                                            StageClock& clock);
  void FindSourcesLocked(BandMap& band);
  void PublishSourceChangesLocked(std::uint8_t band);
  // Makes them its sources(), unless those are newer.
  void Tell(BandMap& band, std::shared_ptr<const Sources> sources);
  absl::Status CheckpointLocked();

  const std::string site_;
  storage::Store* const store_;
  EventRing events_;

  std::mutex writer_mutex_;
  std::mutex finding_mutex_;  // one search at a time; taken before the others
  mutable std::mutex sources_mutex_;
  std::uint64_t sequence_ = 0;  // guarded by writer_mutex_; last journal entry in the maps
  std::int64_t updates_since_checkpoint_ = 0;          // guarded by writer_mutex_
  const std::vector<std::unique_ptr<BandMap>> bands_;  // by number
};

}  // namespace soundmap::pipeline
