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
#include "sound_map/sound_sources.h"
#include "sound_map/source_register.h"
#include "storage/store.h"

namespace soundmap::pipeline {

// The sound map of one site and its sources: one writer at a time, readers on immutable snapshots
// that never wait for it. Evidence enters the journal first, then map and source register; the
// revision of the map is the number of journal entries in it, so that it means the same after a
// restart. Map and sources are functions of the journal up to their revision. Thread safe.
class Region {
 public:
  // The map as the store has it: the tiles of the last checkpoint, then the journal behind it.
  // Where the store has no source register that this version can read, all of the journal.
  static absl::StatusOr<std::unique_ptr<Region>> Open(const std::string& site,
                                                      storage::Store* store,
                                                      const sound_map::SoundMapConfig& config);

  std::shared_ptr<const sound_map::Snapshot> snapshot() const { return map_->TakeSnapshot(); }
  // Of snapshot(), at no cost to the writer.
  std::uint64_t revision() const { return map_->revision(); }

  struct Sources {
    std::vector<sound_map::RegisteredSource> sources;  // most probable first
    std::uint64_t revision = 0;
    std::optional<frames::TimeNs> as_of_ns;
  };
  // As of the register's last update, or of FindSources(): never waits for either.
  std::shared_ptr<const Sources> sources() const;

  // Brings sources() to the newest revision, if it is not there.
  void FindSources();

  // All of the commit takes effect, in the store and in the map, or nothing does. `clock` is told
  // where the stages end.
  absl::Status Commit(const storage::Commit& commit, StageClock& clock);

  // Writes the tiles that changed since the last checkpoint.
  absl::Status Checkpoint();

  EventRing& events() { return events_; }

  // Publishes which of the sources() are new, removed or different since the last call. What
  // happened to sources (SourceEvent) is published by Commit().
  void PublishSourceChanges();

 private:
  Region(std::string site, storage::Store* store, std::unique_ptr<sound_map::SoundMap> map)
      : site_(std::move(site)),
        store_(store),
        map_(std::move(map)),
        register_(map_->config()),
        finder_(map_->config().sources),
        preview_finder_(map_->config().sources) {}
  absl::Status Load();
  // One journal entry enters map and register.
  absl::StatusOr<std::vector<sound_map::SourceEvent>> Apply(const sound_map::EvidenceScan& evidence,
                                                            const AudioScanInfo& scan,
                                                            StageClock& clock);
  void FindSourcesLocked();
  absl::Status CheckpointLocked();

  const std::string site_;
  storage::Store* const store_;
  EventRing events_;

  std::mutex writer_mutex_;
  const std::unique_ptr<sound_map::SoundMap> map_;  // changed with writer_mutex_ held
  sound_map::SourceRegister register_;              // guarded by writer_mutex_
  sound_map::SourceFinder finder_;                  // guarded by writer_mutex_
  std::uint64_t sequence_ = 0;  // guarded by writer_mutex_; last journal entry in map_
  std::int64_t updates_since_checkpoint_ = 0;  // guarded by writer_mutex_

  std::mutex finding_mutex_;                  // one search at a time; taken before sources_mutex_
  std::shared_ptr<const Sources> published_;  // guarded by finding_mutex_
  sound_map::SourceFinder preview_finder_;    // guarded by finding_mutex_
  mutable std::mutex sources_mutex_;
  std::shared_ptr<const Sources> sources_;  // guarded by sources_mutex_; never null once open
};

}  // namespace soundmap::pipeline
