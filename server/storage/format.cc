#include "storage/format.h"

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "storage/files.h"

namespace soundmap::storage {
namespace {

constexpr int kFormatVersion = 1;
constexpr char kFormatPrefix[] = "soundmap data ";

}  // namespace

std::string FormatText() { return absl::StrCat(kFormatPrefix, kFormatVersion, "\n"); }

absl::Status CheckFormat(const std::string& data_dir) {
  const std::string path = data_dir + "/FORMAT";
  const auto text = ReadSmallFile(path);
  if (!text.ok()) return text.status();
  absl::string_view rest = *text;
  int version = 0;
  if (!absl::ConsumePrefix(&rest, kFormatPrefix) || !absl::ConsumeSuffix(&rest, "\n") ||
      !absl::SimpleAtoi(rest, &version) || version < 1) {
    return absl::DataLossError(absl::StrCat(path, " does not say \"", kFormatPrefix, "VERSION\""));
  }
  if (version > kFormatVersion) {
    return absl::FailedPreconditionError(absl::StrCat(
        data_dir, " was written by a newer version of this server: its data format is ", version,
        ", this server knows formats up to ", kFormatVersion));
  }
  return absl::OkStatus();
}

}  // namespace soundmap::storage
