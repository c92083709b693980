#include "storage/names.h"

#include <algorithm>
#include <string>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace soundmap::storage {
namespace {

constexpr std::size_t kMaxNameBytes = 63;
constexpr std::size_t kMaxKeyNames = 4;

bool IsLetterOrDigit(char c) { return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9'); }

bool IsName(absl::string_view name) {
  return !name.empty() && name.size() <= kMaxNameBytes && IsLetterOrDigit(name[0]) &&
         std::all_of(name.begin(), name.end(),
                     [](char c) { return IsLetterOrDigit(c) || c == '-' || c == '_'; });
}

// Short enough for a sentence and safe to print.
std::string Quoted(std::string_view text) {
  const std::string_view start = text.substr(0, kMaxNameBytes + 1);
  return absl::StrCat("\"", absl::CHexEscape(absl::string_view(start.data(), start.size())),
                      start.size() < text.size() ? "..." : "", "\"");
}

}  // namespace

absl::Status ValidateName(std::string_view what, std::string_view name) {
  if (IsName(absl::string_view(name.data(), name.size()))) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("the ", absl::string_view(what.data(), what.size()), " name ", Quoted(name),
                   " is not 1-63 of [a-z0-9_-] that start with a letter or digit"));
}

absl::Status ValidateRecordKey(std::string_view key) {
  const std::vector<absl::string_view> names =
      absl::StrSplit(absl::string_view(key.data(), key.size()), '/');
  if (names.size() <= kMaxKeyNames && std::all_of(names.begin(), names.end(), IsName)) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat("the key ", Quoted(key), " is not made of 1-",
                                                 kMaxKeyNames,
                                                 " names of [a-z0-9_-] joined by '/'"));
}

}  // namespace soundmap::storage
