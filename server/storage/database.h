#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::storage {

struct DatabaseOptions {
  std::int64_t write_buffer_bytes = 0;
  std::int64_t block_cache_bytes = 0;
  int max_open_files = 0;
  std::int64_t min_free_bytes = 0;  // of the disk; with less nothing is written
};

// RocksDB's column families.
enum class Family { kMeta, kJournal, kTiles, kState, kTrajectory };
constexpr int kFamilyCount = 5;

// Changes that take effect together.
struct Batch {
  enum class Kind { kPut, kDelete, kDeleteRange };
  struct Change {
    Kind kind;
    Family family;
    std::string key;
    std::string value;  // of kDeleteRange: the end of the range, which stays
  };
  std::vector<Change> changes;

  void Put(Family family, std::string key, std::string value);
  void Delete(Family family, std::string key);
  void DeleteRange(Family family, std::string first, std::string end);
};

struct DatabaseInstance;

// What a database held at one moment. Its database cannot recover from a failed write meanwhile, so
// do not keep it.
class DatabaseView {
 public:
  absl::StatusOr<std::optional<std::string>> Get(Family family, const std::string& key) const;
  // A number of 8 big-endian bytes; 0 where there is none.
  absl::StatusOr<std::uint64_t> GetNumber(Family family, const std::string& key) const;
  // Keys from `first` up to, not including, `end`, in order.
  absl::Status Scan(Family family, const std::string& first, const std::string& end,
                    const std::function<absl::Status(std::string_view key, std::string_view value)>&
                        callback) const;

 private:
  friend class Database;
  struct State;
  std::shared_ptr<const State> state_;
};

// RocksDB in one folder, its errors as sentences that name it. Thread safe.
//
// After a write for which there was no space RocksDB (7.8) can neither go on nor resume. It then
// only reads, until a later Write() finds space and opens it again.
class Database {
 public:
  // What removes something may use up to 7/8 of `min_free_bytes`.
  enum class Purpose { kAdd, kRemove };

  static absl::StatusOr<std::unique_ptr<Database>> Open(const std::string& folder,
                                                        const DatabaseOptions& options);
  // For those who only look: nothing is changed, not even to recover from a crash.
  static absl::StatusOr<std::unique_ptr<Database>> OpenForReading(const std::string& folder,
                                                                  const DatabaseOptions& options);
  ~Database();

  // Reads every byte. DataLoss names the file whose checksum does not match.
  absl::Status VerifyChecksums() const;
  // Makes a database of what is held now in the folder, which must not exist. What can be shared
  // with this one is linked, not copied.
  absl::Status Checkpoint(const std::string& folder);

  // With `sync` it and all that was written before are on the disk when it returns.
  absl::Status Write(const Batch& batch, bool sync, Purpose purpose = Purpose::kAdd);
  absl::StatusOr<DatabaseView> View() const;

 private:
  Database(std::string folder, const DatabaseOptions& options)
      : folder_(std::move(folder)), options_(options) {}
  absl::StatusOr<std::shared_ptr<DatabaseInstance>> ForWriting(std::int64_t min_free_bytes);

  const std::string folder_;
  const DatabaseOptions options_;
  mutable std::mutex mutex_;                    // guards what follows
  std::shared_ptr<DatabaseInstance> instance_;  // none while it cannot be opened again
};

}  // namespace soundmap::storage
