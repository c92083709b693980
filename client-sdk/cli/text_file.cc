#include "cli/text_file.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace soundmap::cli {
namespace {

constexpr std::int64_t kMaxListBytes = 256 << 20;

}  // namespace

absl::StatusOr<std::string> ReadTextFile(const std::string& path, std::int64_t max_bytes) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error)) {
    return absl::InvalidArgumentError(absl::StrCat(path, " is not a file"));
  }
  errno = 0;
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    const int reason = errno;
    const std::string message = absl::StrCat("cannot read ", path, ": ", std::strerror(reason));
    return reason == ENOENT ? absl::NotFoundError(message) : absl::PermissionDeniedError(message);
  }
  // Not by the file's size: a pipe has none.
  std::string text;
  char block[1 << 16];
  while (file.read(block, sizeof(block)) || file.gcount() > 0) {
    text.append(block, static_cast<std::size_t>(file.gcount()));
    if (static_cast<std::int64_t>(text.size()) > max_bytes) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, " is longer than ", max_bytes, " bytes"));
    }
  }
  return text;
}

absl::Status ForEachLine(
    const std::string& path,
    const std::function<absl::Status(absl::string_view text, const std::string& where)>& line) {
  const auto text = ReadTextFile(path, kMaxListBytes);
  if (!text.ok()) return text.status();
  int number = 0;
  for (absl::string_view content : absl::StrSplit(*text, '\n')) {
    ++number;
    content = absl::StripAsciiWhitespace(content.substr(0, content.find('#')));
    if (content.empty()) continue;
    const absl::Status status = line(content, absl::StrCat(path, ":", number));
    if (!status.ok()) return status;
  }
  return absl::OkStatus();
}

}  // namespace soundmap::cli
