#include "sources/convert/compressed_lines.h"

#include <archive.h>
#include <archive_entry.h>
#include <sys/stat.h>

#include <cerrno>
#include <memory>

#include "absl/strings/str_cat.h"

namespace soundmap::convert {
namespace {

constexpr std::size_t kBlockBytes = 1 << 18;
// A laser line of 10 000 beams takes 70 kB.
constexpr std::size_t kMaxLineBytes = 1 << 24;

struct FreeArchive {
  void operator()(archive* file) const { archive_read_free(file); }
};

std::string Reason(archive* file) {
  const char* text = archive_error_string(file);
  return text ? text : "unknown error";
}

}  // namespace

absl::Status ForEachLine(const std::string& path,
                         const std::function<void(std::string_view, int)>& take) {
  struct stat attributes;
  if (::stat(path.c_str(), &attributes) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot read '", path, "'"));
  }
  if (!S_ISREG(attributes.st_mode)) {
    return absl::InvalidArgumentError(absl::StrCat("'", path, "' is not a file"));
  }
  const std::unique_ptr<archive, FreeArchive> file(archive_read_new());
  archive_read_support_filter_bzip2(file.get());
  archive_read_support_filter_gzip(file.get());
  archive_read_support_filter_xz(file.get());
  archive_read_support_filter_zstd(file.get());
  archive_read_support_format_raw(file.get());
  archive_read_support_format_empty(file.get());
  if (archive_read_open_filename(file.get(), path.c_str(), kBlockBytes) != ARCHIVE_OK) {
    return absl::DataLossError(absl::StrCat("cannot read '", path, "': ", Reason(file.get())));
  }
  archive_entry* entry = nullptr;
  const int opened = archive_read_next_header(file.get(), &entry);
  if (opened == ARCHIVE_EOF) return absl::OkStatus();
  if (opened != ARCHIVE_OK) {
    return absl::DataLossError(
        absl::StrCat("cannot read '", path, "' from its start: ", Reason(file.get())));
  }

  std::string block(kBlockBytes, '\0');
  std::string line;
  int number = 1;
  for (;;) {
    const la_ssize_t size = archive_read_data(file.get(), block.data(), block.size());
    if (size == 0) break;
    if (size < 0) {
      return absl::DataLossError(absl::StrCat("'", path, "' is damaged or cut after line ",
                                              number - 1, ": ", Reason(file.get())));
    }
    std::string_view rest(block.data(), static_cast<std::size_t>(size));
    for (std::size_t end = rest.find('\n'); end != rest.npos; end = rest.find('\n')) {
      line.append(rest.substr(0, end));
      take(line, number++);
      line.clear();
      rest.remove_prefix(end + 1);
    }
    line.append(rest);
    if (line.size() > kMaxLineBytes) {
      return absl::InvalidArgumentError(
          absl::StrCat("line ", number, " of '", path, "' is longer than 16 MiB"));
    }
  }
  if (!line.empty()) take(line, number);
  return absl::OkStatus();
}

}  // namespace soundmap::convert
