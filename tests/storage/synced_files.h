#pragma once

#include <sys/types.h>

#include <atomic>
#include <cstdint>
#include <string>

namespace soundmap::storage {

// What a power failure leaves of the files that another process writes. That process is linked with
// synced_files.cc, which stands before the C library's fsync() and its like, and has the path of a
// table in its environment (SOUNDMAP_SYNCED_FILES). A file keeps the bytes that it had when it was
// last synced, and goes if its folder was not synced since it was made. Renaming and removing
// files are taken to last, as a file system with a journal has them in order. A new file that has
// the inode of a removed one keeps what that had synced, so that less may go than could.
class SyncedFiles {
 public:
  // Makes the table; what lies below `folder` now is on the disk.
  SyncedFiles(const std::string& path, const std::string& folder);
  // The table that the environment names; none: nothing is noted.
  SyncedFiles();
  ~SyncedFiles();
  SyncedFiles(const SyncedFiles&) = delete;
  SyncedFiles& operator=(const SyncedFiles&) = delete;

  // The file had so many bytes when the sync began that has ended now.
  void NoteSynced(ino_t inode, off_t bytes);
  // It is in a folder that was synced.
  void NoteListed(ino_t inode);

  // Takes away what was not synced. The bytes that went.
  std::int64_t Drop(const std::string& folder) const;

 private:
  struct Entry {
    std::atomic<ino_t> inode;  // 0: free
    std::atomic<off_t> bytes;
    std::atomic<bool> listed;
  };
  Entry* Find(ino_t inode) const;
  void Map(const std::string& path, int flags);

  Entry* entries_ = nullptr;  // in memory that both processes share, by open addressing
};

}  // namespace soundmap::storage
