#include "storage/synced_files.h"

#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <vector>

namespace soundmap::storage {
namespace {

constexpr std::size_t kEntries = 1 << 16;

}  // namespace

SyncedFiles::SyncedFiles(const std::string& path, const std::string& folder) {
  std::filesystem::remove(path);
  Map(path, O_RDWR | O_CREAT);
  if (!std::filesystem::exists(folder)) return;
  for (const auto& file : std::filesystem::recursive_directory_iterator(folder)) {
    struct stat status;
    if (::lstat(file.path().c_str(), &status) != 0) continue;
    NoteSynced(status.st_ino, status.st_size);
    NoteListed(status.st_ino);
  }
}

SyncedFiles::SyncedFiles() {
  if (const char* path = std::getenv("SOUNDMAP_SYNCED_FILES")) Map(path, O_RDWR);
}

SyncedFiles::~SyncedFiles() {
  if (entries_ != nullptr) ::munmap(entries_, kEntries * sizeof(Entry));
}

void SyncedFiles::Map(const std::string& path, int flags) {
  const int file = ::open(path.c_str(), flags | O_CLOEXEC, 0600);
  if (file < 0 || ::ftruncate(file, kEntries * sizeof(Entry)) != 0) std::abort();
  void* const memory =
      ::mmap(nullptr, kEntries * sizeof(Entry), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  ::close(file);
  if (memory == MAP_FAILED) std::abort();
  entries_ = static_cast<Entry*>(memory);
}

SyncedFiles::Entry* SyncedFiles::Find(ino_t inode) const {
  for (std::size_t i = inode % kEntries, tried = 0; tried < kEntries;
       i = (i + 1) % kEntries, ++tried) {
    ino_t there = entries_[i].inode;
    if (there == inode) return &entries_[i];
    if (there == 0 && entries_[i].inode.compare_exchange_strong(there, inode)) return &entries_[i];
    if (there == inode) return &entries_[i];
  }
  std::abort();  // more files than any test has
}

void SyncedFiles::NoteSynced(ino_t inode, off_t bytes) {
  if (entries_ == nullptr) return;
  std::atomic<off_t>& synced = Find(inode)->bytes;
  off_t before = synced;
  while (before < bytes && !synced.compare_exchange_weak(before, bytes)) {
  }
}

void SyncedFiles::NoteListed(ino_t inode) {
  if (entries_ != nullptr) Find(inode)->listed = true;
}

std::int64_t SyncedFiles::Drop(const std::string& folder) const {
  std::int64_t lost = 0;
  for (const auto& file : std::filesystem::recursive_directory_iterator(folder)) {
    struct stat status;
    if (!file.is_regular_file() || ::lstat(file.path().c_str(), &status) != 0) continue;
    const Entry* const entry = Find(status.st_ino);
    if (!entry->listed) {
      lost += status.st_size;
      std::filesystem::remove(file.path());
    } else if (entry->bytes < status.st_size) {
      lost += status.st_size - entry->bytes;
      std::filesystem::resize_file(file.path(), static_cast<std::uintmax_t>(entry->bytes));
    }
  }
  return lost;
}

namespace {

// Never destroyed: threads sync until the process is killed.
SyncedFiles& Noted() {
  static auto* const files = new SyncedFiles();
  return *files;
}

// Runs a sync and notes what was there before it.
template <typename Sync>
int Noting(int file, const Sync& sync) {
  struct stat status;
  const bool known = ::fstat(file, &status) == 0;
  std::vector<ino_t> listed;
  if (known && S_ISDIR(status.st_mode)) {
    if (DIR* const folder = ::fdopendir(::openat(file, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC))) {
      while (const dirent* const entry = ::readdir(folder)) listed.push_back(entry->d_ino);
      ::closedir(folder);
    }
  }
  const int result = sync();
  if (!known || result != 0) return result;
  for (const ino_t inode : listed) Noted().NoteListed(inode);
  if (S_ISREG(status.st_mode)) Noted().NoteSynced(status.st_ino, status.st_size);
  return result;
}

template <typename Function>
Function* Next(const char* name) {
  return reinterpret_cast<Function*>(::dlsym(RTLD_NEXT, name));
}

}  // namespace
}  // namespace soundmap::storage

extern "C" {

int fsync(int file) {
  static auto* const next = soundmap::storage::Next<int(int)>("fsync");
  return soundmap::storage::Noting(file, [&] { return next(file); });
}
int fdatasync(int file) {
  static auto* const next = soundmap::storage::Next<int(int)>("fdatasync");
  return soundmap::storage::Noting(file, [&] { return next(file); });
}
}
