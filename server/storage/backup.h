#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/store.h"

namespace soundmap::storage {

struct BackupSize {
  std::int64_t files = 0;
  std::int64_t bytes = 0;
};

// False: stop. `share` is 0 .. 1.
using BackupProgress = std::function<bool(double share)>;

// Copies what the store holds, while it goes on: the folder is a data folder of the moment at which
// this began, with the newer frames of the session logs, and a file MANIFEST with the checksum of
// every other file. It appears as a whole or not at all; what a crash left at FOLDER.part is
// replaced. AlreadyExists; Cancelled; Aborted: a site was deleted meanwhile; ResourceExhausted.
absl::StatusOr<BackupSize> BackUp(const Store& store, const std::string& folder,
                                  const BackupProgress& progress);

// Copies a backup to a data folder, which must not exist, and compares every checksum. DataLoss
// names the file that is not what was backed up.
absl::StatusOr<BackupSize> Restore(const std::string& backup, const std::string& data_dir,
                                   const BackupProgress& progress);

}  // namespace soundmap::storage
