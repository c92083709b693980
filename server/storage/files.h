#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::storage {

// Files and folders whose names outlive a power failure. Errors name the path.

// Of a file or folder; "." where the path has one part.
std::string ParentOf(const std::string& path);

// Creates the folder unless it exists; its parent must exist. Without `sync` its name may not
// outlive a power failure.
absl::Status CreateFolder(const std::string& path, bool sync = true);

// Removes the folder and what is in it; OK if it is not there.
absl::Status RemoveFolder(const std::string& path);

// Makes the names in the folder durable.
absl::Status SyncFolder(const std::string& path);

// Makes the bytes of the file durable.
absl::Status SyncFile(const std::string& path);

// Replaces the file as a whole.
absl::Status WriteSmallFile(const std::string& path, const std::string& text);

// Free space of the disk that holds the path.
absl::StatusOr<std::int64_t> FreeBytes(const std::string& path);

// NotFound if it is missing; InvalidArgument beyond 64 KiB.
absl::StatusOr<std::string> ReadSmallFile(const std::string& path);

// Held by at most one process, and one object in it, at a time.
class FileLock {
 public:
  // FailedPrecondition if somebody else holds it.
  static absl::StatusOr<std::unique_ptr<FileLock>> Acquire(const std::string& path);
  ~FileLock();
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;

 private:
  explicit FileLock(int descriptor) : descriptor_(descriptor) {}
  const int descriptor_;
};

}  // namespace soundmap::storage
