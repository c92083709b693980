#include "storage/database.h"

#include <rocksdb/cache.h>
#include <rocksdb/db.h>
#include <rocksdb/env.h>
#include <rocksdb/listener.h>
#include <rocksdb/table.h>
#include <rocksdb/utilities/checkpoint.h>
#include <rocksdb/write_batch.h>

#include <atomic>
#include <cstdarg>
#include <utility>

#include "absl/base/dynamic_annotations.h"
#include "absl/strings/str_cat.h"
#include "storage/bytes.h"
#include "storage/files.h"

namespace soundmap::storage {
namespace {

using rocksdb::Slice;

constexpr std::array<const char*, kFamilyCount> kFamilyNames = {"meta", "journal", "tiles", "state",
                                                                "trajectory"};
constexpr std::int64_t kMinFreeToReopenBytes = 1 << 20;

// While it lives, this thread is in RocksDB. Debian's is not built with the thread sanitizer, which
// then sees how it copies, compares and frees, but not the atomics by which its threads take turns.
// Its locks are seen all the same.
class InRocksDb {
 public:
  InRocksDb() { ABSL_ANNOTATE_IGNORE_READS_AND_WRITES_BEGIN(); }
  ~InRocksDb() { ABSL_ANNOTATE_IGNORE_READS_AND_WRITES_END(); }
  InRocksDb(const InRocksDb&) = delete;
  InRocksDb& operator=(const InRocksDb&) = delete;
};

absl::Status FromRocks(const rocksdb::Status& status, absl::string_view doing,
                       const std::string& folder) {
  if (status.ok()) return absl::OkStatus();
  const std::string sentence = absl::StrCat("cannot ", doing, " ", folder, ": ", status.ToString());
  if (status.IsNoSpace()) return absl::ResourceExhaustedError(sentence);
  if (status.IsCorruption()) return absl::DataLossError(sentence);
  if (status.IsInvalidArgument()) return absl::InvalidArgumentError(sentence);
  if (status.IsNotSupported()) return absl::FailedPreconditionError(sentence);
  if (status.IsIOError() || status.IsBusy() || status.IsTryAgain() || status.IsTimedOut()) {
    return absl::UnavailableError(sentence);
  }
  return absl::InternalError(sentence);
}

// RocksDB's own recovery would write to the log file that has failed.
class NoRecovery : public rocksdb::EventListener {
 public:
  void OnErrorRecoveryBegin(rocksdb::BackgroundErrorReason, rocksdb::Status,
                            bool* auto_recovery) override {
    *auto_recovery = false;
  }
};

// RocksDB's own log file aborts the process (an assertion) when it is written to after the disk was
// full. Errors are returned anyway.
class NoInfoLog : public rocksdb::Logger {
 public:
  using rocksdb::Logger::Logv;
  void Logv(const char*, va_list) override {}
};

rocksdb::DBOptions DbOptions(const DatabaseOptions& options) {
  rocksdb::DBOptions db_options;
  db_options.create_if_missing = true;
  db_options.create_missing_column_families = true;
  db_options.db_write_buffer_size = static_cast<std::size_t>(options.write_buffer_bytes);
  db_options.max_total_wal_size = 32 << 20;  // what is read again at most when it is opened
  db_options.max_background_jobs = 2;
  db_options.max_open_files = options.max_open_files;
  db_options.bytes_per_sync = 1 << 20;
  db_options.info_log = std::make_shared<NoInfoLog>();
  db_options.stats_dump_period_sec = 0;
  db_options.max_manifest_file_size = 16 << 20;
  // Only a record that a crash has cut may be missing at the end of the log; other damage is
  // reported, not passed over.
  db_options.wal_recovery_mode = rocksdb::WALRecoveryMode::kTolerateCorruptedTailRecords;
  db_options.listeners.push_back(std::make_shared<NoRecovery>());
  return db_options;
}

std::vector<rocksdb::ColumnFamilyDescriptor> Descriptors(const DatabaseOptions& options) {
  rocksdb::BlockBasedTableOptions table_options;
  table_options.block_cache =
      rocksdb::NewLRUCache(static_cast<std::size_t>(options.block_cache_bytes));
  table_options.cache_index_and_filter_blocks = true;
  table_options.block_size = 16 << 10;
  std::vector<rocksdb::ColumnFamilyDescriptor> descriptors = {
      {rocksdb::kDefaultColumnFamilyName, rocksdb::ColumnFamilyOptions()}};
  for (int family = 0; family < kFamilyCount; ++family) {
    rocksdb::ColumnFamilyOptions family_options;
    family_options.table_factory.reset(rocksdb::NewBlockBasedTableFactory(table_options));
    family_options.write_buffer_size = static_cast<std::size_t>(options.write_buffer_bytes) / 4;
    family_options.compression = static_cast<Family>(family) == Family::kJournal
                                     ? rocksdb::kNoCompression  // its entries are compressed
                                     : rocksdb::kZSTD;
    family_options.compression_opts.level = 1;
    descriptors.emplace_back(kFamilyNames[static_cast<std::size_t>(family)], family_options);
  }
  return descriptors;
}

}  // namespace

void Batch::Put(Family family, std::string key, std::string value) {
  changes.push_back({Kind::kPut, family, std::move(key), std::move(value)});
}

void Batch::Delete(Family family, std::string key) {
  changes.push_back({Kind::kDelete, family, std::move(key), {}});
}

void Batch::DeleteRange(Family family, std::string first, std::string end) {
  changes.push_back({Kind::kDeleteRange, family, std::move(first), std::move(end)});
}

struct DatabaseInstance {
  std::string folder;
  std::unique_ptr<rocksdb::DB> db;
  std::array<rocksdb::ColumnFamilyHandle*, kFamilyCount> families = {};
  std::atomic<bool> write_failed = false;

  ~DatabaseInstance() {
    if (!db) return;
    for (rocksdb::ColumnFamilyHandle* family : families) db->DestroyColumnFamilyHandle(family);
    db->Close().PermitUncheckedError();
  }

  rocksdb::ColumnFamilyHandle* Handle(Family family) const {
    return families[static_cast<std::size_t>(family)];
  }

  static absl::StatusOr<std::shared_ptr<DatabaseInstance>> Open(const std::string& folder,
                                                                const DatabaseOptions& options,
                                                                bool only_to_read = false) {
    std::vector<rocksdb::ColumnFamilyHandle*> handles;
    rocksdb::DB* opened = nullptr;
    const rocksdb::Status status =
        only_to_read ? rocksdb::DB::OpenForReadOnly(DbOptions(options), folder,
                                                    Descriptors(options), &handles, &opened)
                     : rocksdb::DB::Open(DbOptions(options), folder, Descriptors(options), &handles,
                                         &opened);
    if (!status.ok()) return FromRocks(status, "open", folder);
    auto instance = std::make_shared<DatabaseInstance>();
    instance->folder = folder;
    instance->db.reset(opened);
    opened->DestroyColumnFamilyHandle(handles[0]);
    for (std::size_t family = 0; family < kFamilyCount; ++family) {
      instance->families[family] = handles[family + 1];
    }
    return instance;
  }
};

struct DatabaseView::State {
  explicit State(std::shared_ptr<DatabaseInstance> instance_in)
      : instance(std::move(instance_in)), snapshot(instance->db->GetSnapshot()) {}
  ~State() { instance->db->ReleaseSnapshot(snapshot); }
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  rocksdb::ReadOptions Options() const {
    rocksdb::ReadOptions read_options;
    read_options.snapshot = snapshot;
    return read_options;
  }

  const std::shared_ptr<DatabaseInstance> instance;
  const rocksdb::Snapshot* const snapshot;
};

absl::StatusOr<std::optional<std::string>> DatabaseView::Get(Family family,
                                                             const std::string& key) const {
  const DatabaseInstance& instance = *state_->instance;
  std::string value;
  const InRocksDb in_rocksdb;
  const rocksdb::Status status =
      instance.db->Get(state_->Options(), instance.Handle(family), key, &value);
  if (status.IsNotFound()) return std::nullopt;
  if (!status.ok()) return FromRocks(status, "read", instance.folder);
  return value;
}

absl::StatusOr<std::uint64_t> DatabaseView::GetNumber(Family family, const std::string& key) const {
  const auto value = Get(family, key);
  if (!value.ok()) return value.status();
  if (!value->has_value()) return 0;
  if ((*value)->size() != 8) {
    return absl::DataLossError(absl::StrCat(state_->instance->folder, " holds a number of ",
                                            (*value)->size(), " bytes, not 8"));
  }
  return BigEndian(**value);
}

absl::Status DatabaseView::Scan(
    Family family, const std::string& first, const std::string& end,
    const std::function<absl::Status(std::string_view, std::string_view)>& callback) const {
  const DatabaseInstance& instance = *state_->instance;
  const Slice upper_bound(end);
  rocksdb::ReadOptions read_options = state_->Options();
  read_options.iterate_upper_bound = &upper_bound;
  read_options.fill_cache = false;
  const std::unique_ptr<rocksdb::Iterator> it(
      instance.db->NewIterator(read_options, instance.Handle(family)));
  const auto step = [&it](auto&& move) {
    const InRocksDb in_rocksdb;
    move();
    return it->Valid();
  };
  for (bool valid = step([&] { it->Seek(first); }); valid; valid = step([&] { it->Next(); })) {
    const absl::Status status =
        callback({it->key().data(), it->key().size()}, {it->value().data(), it->value().size()});
    if (!status.ok()) return status;
  }
  return FromRocks(it->status(), "read", instance.folder);
}

absl::StatusOr<std::unique_ptr<Database>> Database::Open(const std::string& folder,
                                                         const DatabaseOptions& options) {
  auto instance = DatabaseInstance::Open(folder, options);
  if (!instance.ok()) return instance.status();
  std::unique_ptr<Database> database(new Database(folder, options));
  database->instance_ = *std::move(instance);
  return database;
}

absl::StatusOr<std::unique_ptr<Database>> Database::OpenForReading(const std::string& folder,
                                                                   const DatabaseOptions& options) {
  auto instance = DatabaseInstance::Open(folder, options, /*only_to_read=*/true);
  if (!instance.ok()) return instance.status();
  std::unique_ptr<Database> database(new Database(folder, options));
  database->instance_ = *std::move(instance);
  return database;
}

Database::~Database() = default;

absl::Status Database::VerifyChecksums() const {
  const auto view = View();
  if (!view.ok()) return view.status();
  return FromRocks(view->state_->instance->db->VerifyChecksum(), "verify", folder_);
}

absl::Status Database::Checkpoint(const std::string& folder) {
  const auto instance = ForWriting(options_.min_free_bytes);
  if (!instance.ok()) return instance.status();
  const InRocksDb in_rocksdb;
  rocksdb::Checkpoint* made = nullptr;
  rocksdb::Status status = rocksdb::Checkpoint::Create((*instance)->db.get(), &made);
  const std::unique_ptr<rocksdb::Checkpoint> checkpoint(made);
  if (status.ok()) status = checkpoint->CreateCheckpoint(folder);
  return FromRocks(status, "copy to", folder);
}

absl::StatusOr<DatabaseView> Database::View() const {
  DatabaseView view;
  const std::lock_guard lock(mutex_);
  if (!instance_) {
    return absl::UnavailableError(
        absl::StrCat(folder_, " is closed until it can be written to again"));
  }
  view.state_ = std::make_shared<DatabaseView::State>(instance_);
  return view;
}

absl::StatusOr<std::shared_ptr<DatabaseInstance>> Database::ForWriting(
    std::int64_t min_free_bytes) {
  const auto free_bytes = FreeBytes(folder_);
  if (!free_bytes.ok()) return free_bytes.status();
  const std::lock_guard lock(mutex_);
  if (*free_bytes < min_free_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat("cannot write to ", folder_, ": the disk has ",
                                                     *free_bytes, " bytes left, fewer than ",
                                                     min_free_bytes));
  }
  if (instance_ && !instance_->write_failed) return instance_;
  if (*free_bytes < kMinFreeToReopenBytes) {
    return absl::ResourceExhaustedError(
        absl::StrCat("cannot write to ", folder_, ": no space left on device"));
  }
  // It cannot be opened a second time while somebody uses it.
  if (instance_ && instance_.use_count() > 1) {
    return absl::ResourceExhaustedError(
        absl::StrCat("cannot write to ", folder_, ": it waits to be opened again"));
  }
  instance_.reset();
  auto instance = DatabaseInstance::Open(folder_, options_);
  if (!instance.ok()) return instance.status();
  instance_ = *std::move(instance);
  return instance_;
}

absl::Status Database::Write(const Batch& batch, bool sync, Purpose purpose) {
  const auto instance = ForWriting(purpose == Purpose::kRemove ? options_.min_free_bytes / 8
                                                               : options_.min_free_bytes);
  if (!instance.ok()) return instance.status();
  rocksdb::WriteBatch writes;
  for (const Batch::Change& change : batch.changes) {
    rocksdb::ColumnFamilyHandle* const family = (*instance)->Handle(change.family);
    rocksdb::Status status;
    switch (change.kind) {
      case Batch::Kind::kPut:
        status = writes.Put(family, change.key, change.value);
        break;
      case Batch::Kind::kDelete:
        status = writes.Delete(family, change.key);
        break;
      case Batch::Kind::kDeleteRange:
        status = writes.DeleteRange(family, change.key, change.value);
        break;
    }
    if (!status.ok()) return FromRocks(status, "write to", folder_);
  }
  rocksdb::WriteOptions write_options;
  write_options.sync = sync;
  const InRocksDb in_rocksdb;
  const rocksdb::Status status = (*instance)->db->Write(write_options, &writes);
  if (!status.ok()) (*instance)->write_failed = true;
  return FromRocks(status, "write to", folder_);
}

}  // namespace soundmap::storage
