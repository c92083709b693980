#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/commit.h"
#include "storage/store.h"

namespace soundmap::storage {

// Looks at bytes that belong to the store's callers; whatever is not set is not looked at. Records
// come first, those of sites before all others.
struct ContentCheck {
  std::function<absl::Status(Table table, const std::string& key, const std::string& bytes)> record;
  std::function<absl::Status(const std::string& pose)> pose;
  std::function<absl::Status(const std::string& site, const std::string& summary)> summary;
  std::function<absl::Status(const std::string& site, const Tile& tile)> tile;
};

struct DataCheck {
  std::vector<std::string> faults;   // one sentence each
  std::vector<std::string> remarks;  // what a crash leaves behind and recovery mends
  std::int64_t sites = 0;
  std::int64_t sessions = 0;
  std::int64_t segments = 0;
  std::int64_t frames = 0;
  std::int64_t journal_entries = 0;
  std::int64_t tiles = 0;
};

// Reads everything in a data folder that no server uses, and changes nothing: every checksum, every
// encoding, and that what stands at one place is there at the other. Of more than 100 faults the
// rest is counted in the last sentence. An error: it cannot be looked at (in use, of a newer
// version, not a data folder, the database cannot be opened).
absl::StatusOr<DataCheck> CheckData(const std::string& data_dir, const ContentCheck& content);

}  // namespace soundmap::storage
