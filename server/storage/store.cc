#include "storage/store.h"

#include <array>
#include <filesystem>
#include <map>
#include <mutex>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "storage/database.h"
#include "storage/files.h"
#include "storage/format.h"
#include "storage/journal_codec.h"
#include "storage/keys.h"
#include "storage/names.h"

namespace soundmap::storage {
namespace {

constexpr std::size_t kMaxPoseBytes = 64 << 10;

absl::Status ValidateId(const SessionId& id) {
  if (absl::Status site = ValidateName("site", id.site); !site.ok()) return site;
  return ValidateName("session", id.session);
}

// The folder of a new server, or one that a server of this or an earlier version has written.
absl::Status FindOrCreateFormat(const std::string& data_dir) {
  const std::string path = data_dir + "/FORMAT";
  const absl::Status found = CheckFormat(data_dir);
  if (absl::IsNotFound(found)) {
    std::error_code error;
    for (std::filesystem::directory_iterator it(data_dir, error), end; !error && it != end;
         it.increment(error)) {
      const std::string name = it->path().filename().string();
      if (name == "LOCK" || name == "FORMAT.new" || name == "lost+found") continue;
      return absl::FailedPreconditionError(absl::StrCat(
          data_dir,
          " is not empty and has no file FORMAT: it is not a data folder of this server"));
    }
    if (error) return absl::ErrnoToStatus(error.value(), absl::StrCat("cannot list ", data_dir));
    return WriteSmallFile(path, FormatText());
  }
  return found;
}

}  // namespace

struct Store::State {
  std::string data_dir;
  StoreOptions options;
  std::unique_ptr<FileLock> lock;
  std::unique_ptr<Database> database;

  // Taken in this order.
  mutable std::shared_mutex frames_mutex;  // exclusively while frames are dropped
  mutable std::mutex sessions_mutex;       // guards `sessions`
  std::map<SessionId, std::shared_ptr<SessionLog>> sessions;
  std::mutex checkpoint_mutex;  // one checkpoint at a time
  std::mutex commit_mutex;  // one commit at a time: sequences and offsets are read and then written

  std::string database_dir() const { return data_dir + "/db"; }
  std::string sessions_dir() const { return data_dir + "/sessions"; }
  std::string site_dir(const std::string& site) const {
    return absl::StrCat(sessions_dir(), "/", site);
  }

  absl::Status FinishDeletions();
  absl::Status RemoveSiteFolder(const std::string& site);
  absl::StatusOr<std::optional<std::string>> Get(Family family, const std::string& key) const;
  absl::StatusOr<std::uint64_t> GetNumber(const std::string& state_key) const;
  absl::Status DecodeEntry(const std::string& site, std::string_view value,
                           JournalRecord* record) const;
  absl::Status CheckSize(absl::string_view what, const std::string& bytes) const;
  absl::Status CheckCommit(const Commit& commit, std::int64_t processed, std::int64_t heard) const;
};

// A crash in DeleteSite() leaves a mark and the folder of the session logs.
absl::Status Store::State::FinishDeletions() {
  const auto view = database->View();
  if (!view.ok()) return view.status();
  std::vector<std::string> sites;
  absl::Status scanned = view->Scan(Family::kState, std::string(1, kEnd), std::string(1, kAfterEnd),
                                    [&sites](std::string_view key, std::string_view) {
                                      sites.emplace_back(key.substr(1));
                                      return absl::OkStatus();
                                    });
  if (!scanned.ok()) return scanned;
  for (const std::string& site : sites) {
    if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
    if (absl::Status removed = RemoveSiteFolder(site); !removed.ok()) return removed;
  }
  return absl::OkStatus();
}

absl::Status Store::State::RemoveSiteFolder(const std::string& site) {
  if (absl::Status removed = RemoveFolder(site_dir(site)); !removed.ok()) return removed;
  Batch batch;
  batch.Delete(Family::kState, DeletedSiteKey(site));
  return database->Write(batch, /*sync=*/true, Database::Purpose::kRemove);
}

absl::StatusOr<std::optional<std::string>> Store::State::Get(Family family,
                                                             const std::string& key) const {
  const auto view = database->View();
  if (!view.ok()) return view.status();
  return view->Get(family, key);
}

absl::StatusOr<std::uint64_t> Store::State::GetNumber(const std::string& state_key) const {
  const auto view = database->View();
  if (!view.ok()) return view.status();
  return view->GetNumber(Family::kState, state_key);
}

absl::Status Store::State::DecodeEntry(const std::string& site, std::string_view value,
                                       JournalRecord* record) const {
  const absl::Status decoded = DecodeJournalEntry(value, record);
  if (decoded.ok()) return decoded;
  return absl::DataLossError(absl::StrCat("entry ", record->sequence, " of site ", site, " in ",
                                          database_dir(), ": ", decoded.message()));
}

absl::Status Store::State::CheckSize(absl::string_view what, const std::string& bytes) const {
  if (static_cast<std::int64_t>(bytes.size()) <= options.max_record_bytes) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(what, " of ", bytes.size(), " bytes is longer than ", options.max_record_bytes));
}

Store::Store(std::unique_ptr<State> state) : state_(std::move(state)) {}

Store::~Store() {
  for (auto& [id, log] : state_->sessions) log->Close().IgnoreError();
}

absl::StatusOr<std::unique_ptr<Store>> Store::Open(const std::string& data_dir,
                                                   const StoreOptions& options) {
  if (data_dir.empty()) return absl::InvalidArgumentError("the name of the data folder is empty");
  if (options.write_buffer_bytes < 1 << 20 || options.block_cache_bytes < 0 ||
      options.max_open_files < 16 || options.max_record_bytes < 1) {
    return absl::InvalidArgumentError(
        "the store needs write_buffer_bytes of 1 MiB, max_open_files of 16, no negative "
        "block_cache_bytes and a positive max_record_bytes");
  }
  if (absl::Status created = CreateFolder(data_dir); !created.ok()) return created;
  auto lock = FileLock::Acquire(data_dir + "/LOCK");
  if (absl::IsFailedPrecondition(lock.status())) {
    return absl::FailedPreconditionError(
        absl::StrCat("the data folder ", data_dir, " is in use by another process"));
  }
  if (!lock.ok()) return lock.status();
  if (absl::Status checked = FindOrCreateFormat(data_dir); !checked.ok()) return checked;

  auto state = std::make_unique<State>();
  state->data_dir = data_dir;
  state->options = options;
  state->lock = *std::move(lock);
  auto database = Database::Open(state->database_dir(),
                                 {options.write_buffer_bytes, options.block_cache_bytes,
                                  options.max_open_files, options.session_log.min_free_bytes});
  if (!database.ok()) return database.status();
  state->database = *std::move(database);
  std::unique_ptr<Store> store(new Store(std::move(state)));
  if (absl::Status created = CreateFolder(store->state_->sessions_dir()); !created.ok()) {
    return created;
  }
  if (absl::Status finished = store->state_->FinishDeletions(); !finished.ok()) return finished;
  return store;
}

absl::Status Store::PutRecord(Table table, const std::string& key, const std::string& bytes) {
  if (absl::Status valid = ValidateRecordKey(key); !valid.ok()) return valid;
  if (absl::Status fits = state_->CheckSize("a record", bytes); !fits.ok()) return fits;
  Batch batch;
  batch.Put(Family::kMeta, RecordKey(table, key), bytes);
  return state_->database->Write(batch, /*sync=*/true);
}

absl::StatusOr<std::optional<std::string>> Store::GetRecord(Table table,
                                                            const std::string& key) const {
  if (absl::Status valid = ValidateRecordKey(key); !valid.ok()) return valid;
  return state_->Get(Family::kMeta, RecordKey(table, key));
}

absl::StatusOr<std::vector<Record>> Store::ListRecords(Table table,
                                                       const std::string& prefix) const {
  const auto view = state_->database->View();
  if (!view.ok()) return view.status();
  std::vector<Record> records;
  const std::string first = RecordKey(table, prefix);
  const std::string end(1, static_cast<char>(static_cast<char>(table) + 1));
  // A foreign prefix matches nothing; it needs no checks.
  bool past = false;
  const absl::Status scanned = view->Scan(
      Family::kMeta, first, end, [&](std::string_view key, std::string_view bytes) -> absl::Status {
        if (!key.starts_with(first)) {
          past = true;
          return absl::CancelledError();
        }
        records.push_back({std::string(key.substr(1)), std::string(bytes)});
        return absl::OkStatus();
      });
  if (!scanned.ok() && !past) return scanned;
  return records;
}

absl::Status Store::DeleteRecord(Table table, const std::string& key) {
  if (absl::Status valid = ValidateRecordKey(key); !valid.ok()) return valid;
  Batch batch;
  batch.Delete(Family::kMeta, RecordKey(table, key));
  return state_->database->Write(batch, /*sync=*/true, Database::Purpose::kRemove);
}

absl::StatusOr<std::shared_ptr<SessionLog>> Store::OpenSession(const SessionId& id) {
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  const std::lock_guard lock(state_->sessions_mutex);
  const auto open = state_->sessions.find(id);
  if (open != state_->sessions.end()) return open->second;

  const auto dropped = state_->Get(Family::kState, DroppedKey(id));
  if (!dropped.ok()) return dropped.status();
  if (dropped->has_value()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "the frames of session ", id.session, " of site ", id.site, " are not kept any more"));
  }
  const auto known_durable = state_->GetNumber(DurableKey(id));
  if (!known_durable.ok()) return known_durable.status();
  const auto processed = state_->GetNumber(ProcessedKey(id));
  if (!processed.ok()) return processed.status();
  const auto deleted = state_->Get(Family::kState, DeletedSiteKey(id.site));
  if (!deleted.ok()) return deleted.status();
  if (deleted->has_value()) {
    // Frames of an earlier site of this name must not come back.
    if (absl::Status removed = state_->RemoveSiteFolder(id.site); !removed.ok()) return removed;
  }
  const std::string site_folder = state_->site_dir(id.site);
  const auto sibling = state_->sessions.lower_bound({id.site, ""});
  if (sibling == state_->sessions.end() || sibling->first.site != id.site) {
    if (absl::Status created = CreateFolder(site_folder); !created.ok()) return created;
  }
  // The mark is a lower bound that tells a tail which a crash has cut from frames that were lost.
  // It need not be synced, and may fail.
  auto remember = [state = state_.get(), key = DurableKey(id)](std::int64_t durable) {
    Batch batch;
    batch.Put(Family::kState, key, Number(static_cast<std::uint64_t>(durable)));
    state->database->Write(batch, /*sync=*/false).IgnoreError();
  };
  auto log = SessionLog::Open(
      absl::StrCat(site_folder, "/", id.session), state_->options.session_log,
      static_cast<std::int64_t>(std::max(*known_durable, *processed)), std::move(remember));
  if (log.ok()) state_->sessions.emplace(id, *log);
  return log;
}

absl::Status Store::CloseSession(const SessionId& id) {
  std::shared_ptr<SessionLog> log;
  {
    const std::lock_guard lock(state_->sessions_mutex);
    const auto open = state_->sessions.find(id);
    if (open == state_->sessions.end()) return absl::OkStatus();
    log = open->second;
  }
  // Still listed while it closes, so that nobody opens a second log on the folder.
  const absl::Status closed = log->Close();
  const std::lock_guard lock(state_->sessions_mutex);
  const auto open = state_->sessions.find(id);
  if (open != state_->sessions.end() && open->second == log) state_->sessions.erase(open);
  return closed;
}

std::vector<std::pair<SessionId, std::shared_ptr<SessionLog>>> Store::OpenSessions() const {
  const std::lock_guard lock(state_->sessions_mutex);
  return {state_->sessions.begin(), state_->sessions.end()};
}

absl::Status Store::DropState(const SessionId& id) {
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  Batch batch;
  batch.Delete(Family::kState, StateKey(id));
  return state_->database->Write(batch, /*sync=*/false, Database::Purpose::kRemove);
}

absl::Status Store::DropFrames(const SessionId& id) {
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  const std::unique_lock not_held(state_->frames_mutex, std::try_to_lock);
  if (!not_held) return absl::FailedPreconditionError("the frames of all sessions are in use");
  {
    const std::lock_guard lock(state_->sessions_mutex);
    if (state_->sessions.count(id) != 0) {
      return absl::FailedPreconditionError(
          absl::StrCat("the frames of session ", id.session, " of site ", id.site, " are in use"));
    }
    Batch batch;
    batch.Put(Family::kState, DroppedKey(id), Number(0));
    if (absl::Status marked =
            state_->database->Write(batch, /*sync=*/true, Database::Purpose::kRemove);
        !marked.ok()) {
      return marked;
    }
  }
  return RemoveFolder(absl::StrCat(state_->site_dir(id.site), "/", id.session));
}

std::shared_lock<std::shared_mutex> Store::HoldFrames() const {
  return std::shared_lock(state_->frames_mutex);
}

absl::Status Store::State::CheckCommit(const Commit& commit, std::int64_t processed,
                                       std::int64_t heard) const {
  if (commit.processed_offset < processed) {
    return absl::FailedPreconditionError(
        absl::StrCat("session ", commit.session, " of site ", commit.site, " is processed up to ",
                     processed, " already, not to ", commit.processed_offset));
  }
  if (commit.heard_offset < heard || commit.heard_offset > commit.processed_offset) {
    return absl::FailedPreconditionError(
        absl::StrCat("session ", commit.session, " of site ", commit.site, " is heard up to ",
                     heard, " already and processed up to ", commit.processed_offset,
                     ", not heard up to ", commit.heard_offset));
  }
  for (const JournalEntry& entry : commit.journal) {
    if (entry.offset >= heard && entry.offset < commit.heard_offset) continue;
    return absl::FailedPreconditionError(
        absl::StrCat("the audio scan at frame ", entry.offset, " of session ", commit.session,
                     " is not among the frames ", heard, " to ", commit.heard_offset,
                     " that are heard with it"));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::string>> Store::EncodeJournal(const Commit& commit) {
  std::vector<std::string> entries;
  entries.reserve(commit.journal.size());
  for (const JournalEntry& entry : commit.journal) {
    auto encoded = EncodeJournalEntry(commit.session, entry);
    if (!encoded.ok()) return encoded.status();
    entries.push_back(*std::move(encoded));
  }
  return entries;
}

absl::StatusOr<std::uint64_t> Store::CommitBatch(const Commit& commit) {
  const auto entries = EncodeJournal(commit);
  if (!entries.ok()) return entries.status();
  return CommitBatch(commit, *entries);
}

absl::StatusOr<std::uint64_t> Store::CommitBatch(const Commit& commit,
                                                 const std::vector<std::string>& entries) {
  const SessionId id{commit.site, commit.session};
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  Batch batch;
  for (const TrajectoryEntry& entry : commit.trajectory) {
    if (entry.pose.size() > kMaxPoseBytes) {
      return absl::InvalidArgumentError(
          absl::StrCat("a pose of ", entry.pose.size(), " bytes is longer than ", kMaxPoseBytes));
    }
    batch.Put(Family::kTrajectory, TrajectoryKey(id, entry.time_ns), entry.pose);
  }
  if (commit.state) {
    if (commit.state->offset < 0 || commit.state->offset > commit.processed_offset) {
      return absl::InvalidArgumentError(
          absl::StrCat("the state of session ", commit.session, " after ", commit.state->offset,
                       " frames does not belong to the processing of ", commit.processed_offset));
    }
    if (absl::Status fits = state_->CheckSize("a pipeline state", commit.state->state);
        !fits.ok()) {
      return fits;
    }
    batch.Put(Family::kState, StateKey(id),
              Number(static_cast<std::uint64_t>(commit.state->offset)) + commit.state->state);
  }

  std::int64_t durable = -1;
  {
    const std::lock_guard lock(state_->sessions_mutex);
    const auto open = state_->sessions.find(id);
    if (open != state_->sessions.end()) durable = open->second->durable();
  }
  const std::lock_guard lock(state_->commit_mutex);
  if (durable < 0) {
    const auto known_durable = state_->GetNumber(DurableKey(id));
    if (!known_durable.ok()) return known_durable.status();
    durable = static_cast<std::int64_t>(*known_durable);
  }
  if (commit.processed_offset > durable) {
    return absl::FailedPreconditionError(absl::StrCat(
        "frames up to ", commit.processed_offset, " of session ", commit.session, " of site ",
        commit.site, " cannot be processed where only ", durable, " are durable"));
  }
  const auto processed = state_->GetNumber(ProcessedKey(id));
  if (!processed.ok()) return processed.status();
  const auto heard = state_->GetNumber(HeardKey(id));
  if (!heard.ok()) return heard.status();
  if (absl::Status checked = state_->CheckCommit(commit, static_cast<std::int64_t>(*processed),
                                                 static_cast<std::int64_t>(*heard));
      !checked.ok()) {
    return checked;
  }
  const auto last_sequence = state_->GetNumber(LastSequenceKey(commit.site));
  if (!last_sequence.ok()) return last_sequence.status();
  std::uint64_t sequence = *last_sequence;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    ++sequence;
    batch.Put(Family::kJournal, EntryKey(commit.site, sequence), entries[i]);
    batch.Put(Family::kJournal,
              TimeKey(commit.site, commit.journal[i].evidence.stamp_ns) + Number(sequence), "");
  }
  if (!entries.empty()) {
    batch.Put(Family::kState, LastSequenceKey(commit.site), Number(sequence));
  }
  batch.Put(Family::kState, ProcessedKey(id),
            Number(static_cast<std::uint64_t>(commit.processed_offset)));
  batch.Put(Family::kState, HeardKey(id), Number(static_cast<std::uint64_t>(commit.heard_offset)));
  if (absl::Status written = state_->database->Write(batch, /*sync=*/false); !written.ok())
    return written;
  return sequence;
}

absl::StatusOr<std::int64_t> Store::ProcessedOffset(const SessionId& id) const {
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  const auto processed = state_->GetNumber(ProcessedKey(id));
  if (!processed.ok()) return processed.status();
  return static_cast<std::int64_t>(*processed);
}

absl::StatusOr<std::int64_t> Store::HeardOffset(const SessionId& id) const {
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  const auto heard = state_->GetNumber(HeardKey(id));
  if (!heard.ok()) return heard.status();
  return static_cast<std::int64_t>(*heard);
}

absl::StatusOr<std::optional<StateSnapshot>> Store::LatestState(const SessionId& id) const {
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  const auto value = state_->Get(Family::kState, StateKey(id));
  if (!value.ok()) return value.status();
  if (!value->has_value()) return std::nullopt;
  const std::string& bytes = **value;
  if (bytes.size() < 8) {
    return absl::DataLossError(absl::StrCat("the pipeline state of session ", id.session,
                                            " of site ", id.site, " is shorter than its offset"));
  }
  StateSnapshot snapshot;
  snapshot.offset = static_cast<std::int64_t>(BigEndian(std::string_view(bytes).substr(0, 8)));
  snapshot.state = bytes.substr(8);
  return snapshot;
}

absl::Status Store::ReadTrajectory(
    const SessionId& id, frames::TimeNs from_ns, frames::TimeNs to_ns,
    const std::function<absl::Status(const TrajectoryEntry&)>& callback) const {
  if (absl::Status valid = ValidateId(id); !valid.ok()) return valid;
  if (from_ns >= to_ns) return absl::OkStatus();
  const auto view = state_->database->View();
  if (!view.ok()) return view.status();
  return view->Scan(Family::kTrajectory, TrajectoryKey(id, from_ns), TrajectoryKey(id, to_ns),
                    [&callback](std::string_view key, std::string_view pose) {
                      const std::uint64_t time = BigEndian(key.substr(key.size() - 8));
                      return callback({SignedFromSortable(time), std::string(pose)});
                    });
}

absl::StatusOr<std::uint64_t> Store::LastSequence(const std::string& site) const {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  return state_->GetNumber(LastSequenceKey(site));
}

absl::Status Store::ReadJournal(
    const std::string& site, std::uint64_t first_sequence,
    const std::function<absl::Status(const JournalRecord&)>& callback) const {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  const auto view = state_->database->View();
  if (!view.ok()) return view.status();
  JournalRecord record;
  return view->Scan(Family::kJournal, EntryKey(site, first_sequence),
                    EndOfPrefix(EntryPrefix(site)),
                    [&](std::string_view key, std::string_view value) -> absl::Status {
                      record.sequence = BigEndian(key.substr(key.size() - 8));
                      absl::Status decoded = state_->DecodeEntry(site, value, &record);
                      return decoded.ok() ? callback(record) : decoded;
                    });
}

absl::Status Store::ReadJournalRange(
    const std::string& site, frames::TimeNs from_ns, frames::TimeNs to_ns,
    const std::function<absl::Status(const JournalRecord&)>& callback) const {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  if (from_ns >= to_ns) return absl::OkStatus();
  const auto view = state_->database->View();
  if (!view.ok()) return view.status();
  JournalRecord record;
  return view->Scan(
      Family::kJournal, TimeKey(site, from_ns), TimeKey(site, to_ns),
      [&](std::string_view key, std::string_view) -> absl::Status {
        record.sequence = BigEndian(key.substr(key.size() - 8));
        const auto value = view->Get(Family::kJournal, EntryKey(site, record.sequence));
        if (!value.ok()) return value.status();
        absl::Status decoded = state_->DecodeEntry(site, value->value_or(""), &record);
        return decoded.ok() ? callback(record) : decoded;
      });
}

absl::Status Store::PutCheckpoint(const std::string& site, const std::vector<Tile>& tiles,
                                  std::uint64_t journal_sequence,
                                  const std::string& source_register) {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  if (absl::Status fits = state_->CheckSize("a source register", source_register); !fits.ok()) {
    return fits;
  }
  Batch batch;
  if (source_register.empty()) {
    batch.Delete(Family::kState, SourceRegisterKey(site));
  } else {
    batch.Put(Family::kState, SourceRegisterKey(site), source_register);
  }
  for (const Tile& tile : tiles) {
    if (tile.key.band > TileKey::kMaxBand) {
      return absl::InvalidArgumentError(
          absl::StrCat("a tile of site ", site, " is of band ", tile.key.band));
    }
    if (absl::Status fits = state_->CheckSize("a tile", tile.bytes); !fits.ok()) return fits;
    const std::string key = TileKeyBytes(site, tile.key);
    if (tile.bytes.empty()) {
      batch.Delete(Family::kTiles, key);
    } else {
      batch.Put(Family::kTiles, key, tile.bytes);
    }
  }
  batch.Put(Family::kState, CheckpointKey(site), Number(journal_sequence));
  const std::lock_guard lock(state_->checkpoint_mutex);
  const auto before = state_->GetNumber(CheckpointKey(site));
  if (!before.ok()) return before.status();
  const auto last = state_->GetNumber(LastSequenceKey(site));
  if (!last.ok()) return last.status();
  if (journal_sequence < *before || journal_sequence > *last) {
    return absl::FailedPreconditionError(absl::StrCat(
        "a checkpoint of site ", site, " at journal entry ", journal_sequence,
        " is not between the checkpoint before, ", *before, ", and the last entry, ", *last));
  }
  return state_->database->Write(batch, /*sync=*/true);
}

absl::StatusOr<std::string> Store::ReadSourceRegister(const std::string& site) const {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  auto bytes = state_->Get(Family::kState, SourceRegisterKey(site));
  if (!bytes.ok()) return bytes.status();
  return bytes->value_or("");
}

absl::StatusOr<std::uint64_t> Store::ReadTiles(
    const std::string& site, const std::function<absl::Status(const Tile&)>& callback) const {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  const auto view = state_->database->View();
  if (!view.ok()) return view.status();
  const auto sequence = view->GetNumber(Family::kState, CheckpointKey(site));
  if (!sequence.ok()) return sequence.status();
  const std::string first = SiteKey(site);
  const absl::Status scanned =
      view->Scan(Family::kTiles, first, EndOfPrefix(first),
                 [&](std::string_view key, std::string_view bytes) -> absl::Status {
                   const auto tile = TileKeyFromBytes(key.substr(first.size()));
                   if (!tile) {
                     return absl::DataLossError(absl::StrCat(
                         "a tile of site ", site, " in ", state_->database_dir(), " has a key of ",
                         key.size() - first.size(), " bytes that is none"));
                   }
                   return callback({*tile, std::string(bytes)});
                 });
  if (!scanned.ok()) return scanned;
  return sequence;
}

absl::StatusOr<std::uint64_t> Store::CheckpointSequence(const std::string& site) const {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  return state_->GetNumber(CheckpointKey(site));
}

absl::Status Store::DeleteSite(const std::string& site) {
  if (absl::Status valid = ValidateName("site", site); !valid.ok()) return valid;
  const std::lock_guard sessions_lock(state_->sessions_mutex);
  const std::lock_guard checkpoint_lock(state_->checkpoint_mutex);
  const std::lock_guard commit_lock(state_->commit_mutex);
  for (auto it = state_->sessions.begin(); it != state_->sessions.end();) {
    if (it->first.site == site) {
      it->second->Abandon();
      it = state_->sessions.erase(it);
    } else {
      ++it;
    }
  }
  Batch batch;
  const std::string first = SiteKey(site);
  const std::string end = EndOfPrefix(first);
  for (const Family family :
       {Family::kJournal, Family::kTiles, Family::kState, Family::kTrajectory}) {
    batch.DeleteRange(family, first, end);
  }
  for (const Table table : {Table::kSite, Table::kSession, Table::kBuilding, Table::kOperation}) {
    const std::string record = RecordKey(table, site);
    batch.Delete(Family::kMeta, record);
    batch.DeleteRange(Family::kMeta, record + '/', EndOfPrefix(record + '/'));
  }
  batch.Put(Family::kState, DeletedSiteKey(site), "");
  if (absl::Status written =
          state_->database->Write(batch, /*sync=*/true, Database::Purpose::kRemove);
      !written.ok())
    return written;
  return state_->RemoveSiteFolder(site);
}

const std::string& Store::data_dir() const { return state_->data_dir; }

absl::Status Store::CheckpointDatabase(const std::string& folder) const {
  return state_->database->Checkpoint(folder);
}

}  // namespace soundmap::storage
