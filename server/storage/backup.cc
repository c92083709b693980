#include "storage/backup.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "storage/crc32c.h"
#include "storage/files.h"
#include "storage/format.h"

namespace soundmap::storage {
namespace {

namespace fs = std::filesystem;

constexpr char kManifest[] = "MANIFEST";
constexpr std::size_t kCopyBytes = 1 << 20;
// For the folders above: a copy must not fill the disk that robots' frames go to.
constexpr std::int64_t kMinFreeBytes = 64 << 20;

struct CopiedFile {
  std::string path;  // below the folder
  std::int64_t bytes = 0;
  std::uint32_t crc32c = 0;
};

absl::Status IoError(const std::string& path, const std::error_code& error) {
  return absl::ErrnoToStatus(error.value(), absl::StrCat("cannot copy ", path));
}

// Copies and syncs; reads up to the end as it is when it is reached.
absl::StatusOr<CopiedFile> CopyFile(const fs::path& from, const fs::path& to) {
  std::FILE* const in = std::fopen(from.c_str(), "rbe");
  if (in == nullptr) return absl::ErrnoToStatus(errno, absl::StrCat("cannot read ", from.string()));
  std::FILE* const out = std::fopen(to.c_str(), "wbxe");
  absl::Status status =
      out == nullptr ? absl::ErrnoToStatus(errno, absl::StrCat("cannot create ", to.string()))
                     : absl::OkStatus();
  CopiedFile copied;
  std::string buffer(kCopyBytes, '\0');
  while (status.ok()) {
    const std::size_t read = std::fread(buffer.data(), 1, buffer.size(), in);
    if (read == 0) {
      if (std::ferror(in) != 0) {
        status = absl::ErrnoToStatus(errno, absl::StrCat("cannot read ", from.string()));
      }
      break;
    }
    copied.crc32c = Crc32c(std::string_view(buffer).substr(0, read), copied.crc32c);
    copied.bytes += static_cast<std::int64_t>(read);
    if (std::fwrite(buffer.data(), 1, read, out) != read) {
      status = absl::ErrnoToStatus(errno, absl::StrCat("cannot write ", to.string()));
    }
  }
  if (out != nullptr) {
    if (status.ok() && (std::fflush(out) != 0 || ::fdatasync(::fileno(out)) != 0)) {
      status = absl::ErrnoToStatus(errno, absl::StrCat("cannot write ", to.string()));
    }
    std::fclose(out);
  }
  std::fclose(in);
  if (!status.ok()) return status;
  return copied;
}

absl::Status CheckSpace(const std::string& folder, std::int64_t needed_bytes) {
  const auto free_bytes = FreeBytes(folder);
  if (!free_bytes.ok()) return free_bytes.status();
  if (*free_bytes - needed_bytes >= kMinFreeBytes) return absl::OkStatus();
  return absl::ResourceExhaustedError(absl::StrCat("a copy of ", needed_bytes,
                                                   " bytes does not fit beside ", folder,
                                                   ", where ", *free_bytes, " bytes are left"));
}

absl::StatusOr<std::string> ReadManifest(const std::string& backup) {
  const std::string path = absl::StrCat(backup, "/", kManifest);
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  if (!file || !(text << file.rdbuf())) {
    return absl::NotFoundError(absl::StrCat(backup, " is not a backup: it has no file MANIFEST"));
  }
  return std::move(text).str();
}

// The last line of the manifest: the checksum of those before.
std::string Seal(std::string_view lines) { return absl::StrFormat("%08x\n", Crc32c(lines)); }

// Lines "CRC32C BYTES PATH".
absl::StatusOr<std::vector<CopiedFile>> ParseManifest(const std::string& backup) {
  const auto text = ReadManifest(backup);
  if (!text.ok()) return text.status();
  std::vector<CopiedFile> files;
  const std::string_view lines =
      std::string_view(*text).substr(0, text->size() - std::min<std::size_t>(9, text->size()));
  if (text->substr(lines.size()) != Seal(lines)) {
    return absl::DataLossError(absl::StrCat(backup, "/", kManifest, " is damaged"));
  }
  for (const absl::string_view line :
       absl::StrSplit(absl::string_view(lines.data(), lines.size()), '\n', absl::SkipEmpty())) {
    const std::vector<std::string> parts = absl::StrSplit(line, ' ');
    CopiedFile file;
    if (parts.size() != 3 || !absl::SimpleHexAtoi(parts[0], &file.crc32c) ||
        !absl::SimpleAtoi(parts[1], &file.bytes) || absl::StrContains(parts[2], "..") ||
        absl::StartsWith(parts[2], "/")) {
      return absl::DataLossError(absl::StrCat(backup, "/", kManifest, " is damaged"));
    }
    file.path = parts[2];
    files.push_back(std::move(file));
  }
  return files;
}

// Every regular file below a folder, with its size; names relative to it.
absl::StatusOr<std::vector<CopiedFile>> ListFiles(const fs::path& folder) {
  std::vector<CopiedFile> files;
  std::error_code error;
  for (fs::recursive_directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (!it->is_regular_file(error) || it->path().extension() == ".torn") continue;
    const auto bytes = static_cast<std::int64_t>(it->file_size(error));
    files.push_back({it->path().lexically_relative(folder).string(), bytes});
  }
  if (error) return IoError(folder.string(), error);
  return files;
}

// Folders of `path` below `folder`, durable.
absl::Status MakeFolders(const std::string& folder, const std::string& path) {
  for (std::size_t slash = path.find('/'); slash != std::string::npos;
       slash = path.find('/', slash + 1)) {
    if (absl::Status made = CreateFolder(absl::StrCat(folder, "/", path.substr(0, slash)));
        !made.ok()) {
      return made;
    }
  }
  return absl::OkStatus();
}

absl::Status Rename(const std::string& from, const std::string& to) {
  if (::rename(from.c_str(), to.c_str()) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot rename ", from, " to ", to));
  }
  const std::string parent = fs::path(to).lexically_normal().parent_path().string();
  return SyncFolder(parent.empty() ? "." : parent);
}

absl::Status PrepareDraft(const std::string& folder, const std::string& draft) {
  std::error_code error;
  if (fs::exists(folder, error)) {
    return absl::AlreadyExistsError(absl::StrCat(folder, " exists already"));
  }
  if (absl::Status removed = RemoveFolder(draft); !removed.ok()) return removed;
  return CreateFolder(draft);
}

absl::StatusOr<BackupSize> FillBackup(const Store& store, const std::string& draft,
                                      const BackupProgress& progress) {
  const auto held = store.HoldFrames();
  // The database first: the logs hold at least the frames that it speaks of.
  if (absl::Status copied = store.CheckpointDatabase(draft + "/db"); !copied.ok()) return copied;
  const fs::path logs = store.data_dir() + "/sessions";
  std::int64_t total = 0;
  auto segments = ListFiles(logs);
  if (!segments.ok()) return segments.status();
  for (const CopiedFile& segment : *segments) total += segment.bytes;
  if (absl::Status fits = CheckSpace(draft, total); !fits.ok()) return fits;

  if (absl::Status made = CreateFolder(draft + "/sessions"); !made.ok()) return made;
  std::int64_t done = 0;
  for (const CopiedFile& segment : *segments) {
    if (!progress(total == 0 ? 0.0 : static_cast<double>(done) / static_cast<double>(total))) {
      return absl::CancelledError("the backup was cancelled");
    }
    if (absl::Status made = MakeFolders(draft + "/sessions", segment.path); !made.ok()) return made;
    const auto copied = CopyFile(logs / segment.path, fs::path(draft) / "sessions" / segment.path);
    if (absl::IsNotFound(copied.status())) {
      return absl::AbortedError(absl::StrCat(
          segment.path, " went while it was to be copied: its site was deleted; begin again"));
    }
    if (!copied.ok()) return copied.status();
    done += segment.bytes;
  }
  if (absl::Status written = WriteSmallFile(draft + "/FORMAT", FormatText()); !written.ok()) {
    return written;
  }

  // What was written is read again: the checksums are of what is there.
  const auto files = ListFiles(draft);
  if (!files.ok()) return files.status();
  BackupSize size;
  std::string manifest;
  std::string buffer;
  for (const CopiedFile& file : *files) {
    std::ifstream in(absl::StrCat(draft, "/", file.path), std::ios::binary);
    std::uint32_t crc = 0;
    std::int64_t bytes = 0;
    buffer.resize(kCopyBytes);
    while (in.read(buffer.data(), static_cast<std::streamsize>(buffer.size())) || in.gcount() > 0) {
      crc = Crc32c(std::string_view(buffer).substr(0, static_cast<std::size_t>(in.gcount())), crc);
      bytes += in.gcount();
    }
    if (in.bad() || bytes != file.bytes) {
      return absl::UnavailableError(absl::StrCat("cannot read ", draft, "/", file.path));
    }
    absl::StrAppendFormat(&manifest, "%08x %d %s\n", crc, bytes, file.path);
    ++size.files;
    size.bytes += bytes;
  }
  if (absl::Status written =
          WriteSmallFile(absl::StrCat(draft, "/", kManifest), manifest + Seal(manifest));
      !written.ok()) {
    return written;
  }
  return size;
}

absl::StatusOr<BackupSize> FillRestored(const std::string& backup, const std::string& draft,
                                        const BackupProgress& progress) {
  const auto files = ParseManifest(backup);
  if (!files.ok()) return files.status();
  std::int64_t total = 0;
  for (const CopiedFile& file : *files) total += file.bytes;
  if (absl::Status fits = CheckSpace(draft, total); !fits.ok()) return fits;
  BackupSize size;
  for (const CopiedFile& file : *files) {
    if (!progress(static_cast<double>(size.bytes) / static_cast<double>(total))) {
      return absl::CancelledError("the restoration was cancelled");
    }
    if (absl::Status made = MakeFolders(draft, file.path); !made.ok()) return made;
    const fs::path from = fs::path(backup) / file.path;
    const auto copied = CopyFile(from, fs::path(draft) / file.path);
    if (absl::IsNotFound(copied.status())) {
      return absl::DataLossError(absl::StrCat(from.string(), " is missing in the backup"));
    }
    if (!copied.ok()) return copied.status();
    if (copied->bytes != file.bytes || copied->crc32c != file.crc32c) {
      return absl::DataLossError(
          absl::StrCat(from.string(), " is not what was backed up: its checksum does not match"));
    }
    ++size.files;
    size.bytes += copied->bytes;
  }
  return size;
}

absl::StatusOr<BackupSize> Finish(absl::StatusOr<BackupSize> filled, const std::string& draft,
                                  const std::string& folder) {
  if (!filled.ok()) {
    RemoveFolder(draft).IgnoreError();
    return filled;
  }
  if (absl::Status renamed = Rename(draft, folder); !renamed.ok()) return renamed;
  return filled;
}

}  // namespace

absl::StatusOr<BackupSize> BackUp(const Store& store, const std::string& folder,
                                  const BackupProgress& progress) {
  const std::string draft = folder + ".part";
  if (absl::Status prepared = PrepareDraft(folder, draft); !prepared.ok()) return prepared;
  return Finish(FillBackup(store, draft, progress), draft, folder);
}

absl::StatusOr<BackupSize> Restore(const std::string& backup, const std::string& data_dir,
                                   const BackupProgress& progress) {
  const std::string draft = data_dir + ".part";
  if (absl::Status format = CheckFormat(backup); !format.ok()) {
    return absl::IsNotFound(format) ? absl::NotFoundError(absl::StrCat(backup, " is not a backup"))
                                    : format;
  }
  if (absl::Status prepared = PrepareDraft(data_dir, draft); !prepared.ok()) return prepared;
  return Finish(FillRestored(backup, draft, progress), draft, data_dir);
}

}  // namespace soundmap::storage
