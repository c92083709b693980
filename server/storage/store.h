#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <shared_mutex>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/commit.h"
#include "storage/session_log.h"

namespace soundmap::storage {

// Kinds of records, and how their keys are made of names (names.h). Those that begin with a site go
// when the site goes.
enum class Table : std::uint8_t {
  kSite = 1,       // site
  kSession = 2,    // site/session
  kBuilding = 3,   // site/version (of the geometric map) or site/version/part
  kOperation = 4,  // site/operation
  kRobot = 5,      // robot
  kServer = 6,     // what concerns the server as a whole
};

struct Record {
  std::string key;
  std::string bytes;
};

struct SessionId {
  std::string site;
  std::string session;

  auto operator<=>(const SessionId&) const = default;
};

struct StoreOptions {
  SessionLogOptions session_log;
  std::int64_t write_buffer_bytes = 64 << 20;  // RocksDB's memtables, all together
  std::int64_t block_cache_bytes = 32 << 20;
  int max_open_files = 256;
  std::int64_t max_record_bytes = 256 << 20;  // of a record's, state's or tile's bytes
};

// All that the server keeps, in one folder; FORMAT.md says how. Sites do not see each other. Every
// method may be called on any thread. The bytes of records, summaries, poses, states and tiles
// belong to the callers, who give them versions of their own.
//
// Errors everywhere: InvalidArgument for a bad name or a size beyond its limit, ResourceExhausted
// when the disk is full (what was stored stays; a later call succeeds once there is space),
// DataLoss for damage, naming the file. A callback's error ends the reading and is returned.
class Store {
 public:
  // Creates the folder if it is missing. FailedPrecondition: another process uses it, a newer
  // version wrote it, or it is not a data folder.
  static absl::StatusOr<std::unique_ptr<Store>> Open(const std::string& data_dir,
                                                     const StoreOptions& options = {});
  ~Store();  // syncs and closes the session logs

  // Records. Put and Delete are on the disk when they return.
  absl::Status PutRecord(Table table, const std::string& key, const std::string& bytes);
  absl::StatusOr<std::optional<std::string>> GetRecord(Table table, const std::string& key) const;
  // In the order of the keys. `prefix` is plain text: "site/" for what belongs to a site.
  absl::StatusOr<std::vector<Record>> ListRecords(Table table, const std::string& prefix) const;
  absl::Status DeleteRecord(Table table, const std::string& key);

  // Session logs. Opens or creates; the same log as before while it is open. DataLoss: durable
  // frames are gone.
  absl::StatusOr<std::shared_ptr<SessionLog>> OpenSession(const SessionId& id);
  // Syncs the log and closes it; OK if it is not open.
  absl::Status CloseSession(const SessionId& id);
  std::vector<std::pair<SessionId, std::shared_ptr<SessionLog>>> OpenSessions() const;
  // The session needs no state any more; its frames, path and evidence stay.
  absl::Status DropState(const SessionId& id);
  // Removes the session's log for good; OpenSession() is FailedPrecondition from then on, and so is
  // this while the log is open or frames are held. After an error or a crash in between it must be
  // called again.
  absl::Status DropFrames(const SessionId& id);
  // While this is held, no frames are dropped.
  std::shared_lock<std::shared_mutex> HoldFrames() const;

  // Processing. Written, not synced: the session log is the truth, and a power failure takes whole
  // commits from the end. Returns the sequence of the site's last journal entry.
  // FailedPrecondition: an offset lies behind that of an earlier commit, processed_offset beyond
  // the log's durable() or heard_offset beyond processed_offset, or a journal entry's offset is not
  // in [earlier heard_offset, heard_offset): it has been counted.
  absl::StatusOr<std::uint64_t> CommitBatch(const Commit& commit);
  // The same in two steps, the first of which needs no order among the commits.
  static absl::StatusOr<std::vector<std::string>> EncodeJournal(const Commit& commit);
  absl::StatusOr<std::uint64_t> CommitBatch(const Commit& commit,
                                            const std::vector<std::string>& encoded_journal);
  absl::StatusOr<std::int64_t> ProcessedOffset(const SessionId& id) const;
  absl::StatusOr<std::int64_t> HeardOffset(const SessionId& id) const;
  absl::StatusOr<std::optional<StateSnapshot>> LatestState(const SessionId& id) const;
  // Poses with from_ns <= time < to_ns, oldest first.
  absl::Status ReadTrajectory(
      const SessionId& id, frames::TimeNs from_ns, frames::TimeNs to_ns,
      const std::function<absl::Status(const TrajectoryEntry&)>& callback) const;

  // Evidence journal. 0 while it is empty.
  absl::StatusOr<std::uint64_t> LastSequence(const std::string& site) const;
  // Entries from `first_sequence` on, in their order.
  absl::Status ReadJournal(const std::string& site, std::uint64_t first_sequence,
                           const std::function<absl::Status(const JournalRecord&)>& callback) const;
  // Entries with from_ns <= t_k < to_ns, by t_k and then by sequence.
  absl::Status ReadJournalRange(
      const std::string& site, frames::TimeNs from_ns, frames::TimeNs to_ns,
      const std::function<absl::Status(const JournalRecord&)>& callback) const;

  // Tiles. `journal_sequence`: the last entry that the tiles and the source register (the sound
  // map's own bytes; empty: none) contain; it never goes back. Atomic and on the disk when it
  // returns.
  absl::Status PutCheckpoint(const std::string& site, const std::vector<Tile>& tiles,
                             std::uint64_t journal_sequence,
                             const std::string& source_register = {});
  // As it was given with the last checkpoint; empty: it had none.
  absl::StatusOr<std::string> ReadSourceRegister(const std::string& site) const;
  // All tiles of the site, in the order of their keys, and the sequence that they belong to.
  absl::StatusOr<std::uint64_t> ReadTiles(
      const std::string& site, const std::function<absl::Status(const Tile&)>& callback) const;
  absl::StatusOr<std::uint64_t> CheckpointSequence(const std::string& site) const;

  // Removes everything of the site; its open logs are abandoned. After a crash in between, Open()
  // finishes the work.
  absl::Status DeleteSite(const std::string& site);

  const std::string& data_dir() const;
  // Makes a folder with a copy of the database as it is now; the session logs are at least as new.
  absl::Status CheckpointDatabase(const std::string& folder) const;

 private:
  struct State;
  explicit Store(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace soundmap::storage
