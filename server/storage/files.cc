#include "storage/files.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"

namespace soundmap::storage {
namespace {

constexpr std::size_t kMaxSmallFileBytes = 64 << 10;

absl::Status ErrnoStatus(absl::string_view doing, const std::string& path) {
  return absl::ErrnoToStatus(errno, absl::StrCat("cannot ", doing, " ", path));
}

class Descriptor {
 public:
  Descriptor(const std::string& path, int flags)
      : value_(::open(path.c_str(), flags | O_CLOEXEC, 0644)) {}
  ~Descriptor() {
    if (value_ >= 0) ::close(value_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int value() const { return value_; }
  int Release() { return std::exchange(value_, -1); }

 private:
  int value_;
};

}  // namespace

std::string ParentOf(const std::string& path) {
  const std::string parent = std::filesystem::path(path).lexically_normal().parent_path().string();
  return parent.empty() ? "." : parent;
}

absl::Status CreateFolder(const std::string& path, bool sync) {
  if (::mkdir(path.c_str(), 0755) != 0) {
    if (errno != EEXIST) return ErrnoStatus("create the folder", path);
    std::error_code error;
    if (!std::filesystem::is_directory(path, error)) {
      return absl::FailedPreconditionError(absl::StrCat(path, " is not a folder"));
    }
  }
  return sync ? SyncFolder(ParentOf(path)) : absl::OkStatus();
}

absl::Status RemoveFolder(const std::string& path) {
  std::error_code error;
  std::filesystem::remove_all(path, error);
  if (error) {
    return absl::ErrnoToStatus(error.value(), absl::StrCat("cannot remove the folder ", path));
  }
  return SyncFolder(ParentOf(path));
}

absl::Status SyncFolder(const std::string& path) {
  const Descriptor folder(path, O_RDONLY | O_DIRECTORY);
  if (folder.value() < 0) return ErrnoStatus("open the folder", path);
  if (::fsync(folder.value()) != 0) return ErrnoStatus("sync the folder", path);
  return absl::OkStatus();
}

absl::Status SyncFile(const std::string& path) {
  const Descriptor file(path, O_RDONLY);
  if (file.value() < 0) return ErrnoStatus("open", path);
  if (::fdatasync(file.value()) != 0) return ErrnoStatus("sync", path);
  return absl::OkStatus();
}

absl::Status WriteSmallFile(const std::string& path, const std::string& text) {
  const std::string draft = path + ".new";
  {
    const Descriptor file(draft, O_WRONLY | O_CREAT | O_TRUNC);
    if (file.value() < 0) return ErrnoStatus("create", draft);
    const ssize_t written = ::write(file.value(), text.data(), text.size());
    if (written >= 0 && static_cast<std::size_t>(written) != text.size()) errno = ENOSPC;
    if (written < 0 || static_cast<std::size_t>(written) != text.size()) {
      return ErrnoStatus("write", draft);
    }
    if (::fsync(file.value()) != 0) return ErrnoStatus("sync", draft);
  }
  if (::rename(draft.c_str(), path.c_str()) != 0) return ErrnoStatus("write", path);
  return SyncFolder(ParentOf(path));
}

absl::StatusOr<std::int64_t> FreeBytes(const std::string& path) {
  struct statvfs disk = {};
  if (::statvfs(path.c_str(), &disk) != 0) return ErrnoStatus("inspect the disk of", path);
  return static_cast<std::int64_t>(disk.f_bavail) * static_cast<std::int64_t>(disk.f_frsize);
}

absl::StatusOr<std::string> ReadSmallFile(const std::string& path) {
  const Descriptor file(path, O_RDONLY);
  if (file.value() < 0) return ErrnoStatus("open", path);
  std::string text(kMaxSmallFileBytes + 1, '\0');
  std::size_t size = 0;
  while (size < text.size()) {
    const ssize_t count = ::read(file.value(), text.data() + size, text.size() - size);
    if (count < 0) return ErrnoStatus("read", path);
    if (count == 0) break;
    size += static_cast<std::size_t>(count);
  }
  if (size > kMaxSmallFileBytes) {
    return absl::InvalidArgumentError(absl::StrCat(path, " is longer than it can be"));
  }
  text.resize(size);
  return text;
}

absl::StatusOr<std::unique_ptr<FileLock>> FileLock::Acquire(const std::string& path) {
  Descriptor file(path, O_RDWR | O_CREAT);
  if (file.value() < 0) return ErrnoStatus("open", path);
  if (::flock(file.value(), LOCK_EX | LOCK_NB) != 0) {
    if (errno == EWOULDBLOCK) {
      return absl::FailedPreconditionError(absl::StrCat(path, " is locked"));
    }
    return ErrnoStatus("lock", path);
  }
  return std::unique_ptr<FileLock>(new FileLock(file.Release()));
}

FileLock::~FileLock() { ::close(descriptor_); }

}  // namespace soundmap::storage
