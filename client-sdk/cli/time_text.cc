#include "cli/time_text.h"

#include <cmath>
#include <limits>
#include <optional>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "absl/time/time.h"

namespace soundmap::cli {
namespace {

constexpr double kNsPerS = 1e9;
// int64 nanoseconds end in the year 2262.
constexpr double kMaxS = 9.2e9;

std::optional<double> AgeInSeconds(absl::string_view text) {
  absl::ConsumeSuffix(&text, "ago");
  text = absl::StripAsciiWhitespace(text);
  if (text.empty()) return std::nullopt;
  double unit_s = 0.0;
  switch (text.back()) {
    case 's':
      unit_s = 1.0;
      break;
    case 'm':
      unit_s = 60.0;
      break;
    case 'h':
      unit_s = 3600.0;
      break;
    case 'd':
      unit_s = 86400.0;
      break;
    default:
      return std::nullopt;
  }
  double count = 0.0;
  if (!absl::SimpleAtod(text.substr(0, text.size() - 1), &count) || !(count >= 0.0) ||
      !(count * unit_s <= kMaxS)) {
    return std::nullopt;
  }
  return count * unit_s;
}

std::optional<std::int64_t> IsoTime(absl::string_view text) {
  static constexpr const char* kFormats[] = {"%Y-%m-%d%ET%H:%M:%E*S%Ez",
                                             "%Y-%m-%d%ET%H:%M:%E*S",
                                             "%Y-%m-%d%ET%H:%M%Ez",
                                             "%Y-%m-%d%ET%H:%M",
                                             "%Y-%m-%d %H:%M:%E*S",
                                             "%Y-%m-%d %H:%M",
                                             "%Y-%m-%d"};
  absl::Time time;
  for (const char* format : kFormats) {
    if (!absl::ParseTime(format, text, absl::UTCTimeZone(), &time, nullptr)) continue;
    if (time < absl::UnixEpoch() ||
        time > absl::FromUnixSeconds(static_cast<std::int64_t>(kMaxS))) {
      return std::nullopt;
    }
    return absl::ToUnixNanos(time);
  }
  return std::nullopt;
}

}  // namespace

absl::StatusOr<std::int64_t> ParseSince(const std::string& text, std::int64_t now_ns) {
  double seconds = 0.0;
  if (absl::SimpleAtod(text, &seconds)) {
    if (seconds >= 0.0 && seconds <= kMaxS) return std::llround(seconds * kNsPerS);
  } else if (const auto age_s = AgeInSeconds(text)) {
    const double age_ns = *age_s * kNsPerS;
    return age_ns >= static_cast<double>(now_ns) ? 0 : now_ns - std::llround(age_ns);
  } else if (const auto time_ns = IsoTime(text)) {
    return *time_ns;
  }
  return absl::InvalidArgumentError(
      absl::StrCat("\"", text,
                   "\" is not a time: give ISO 8601, seconds since 1970, or an age such as 10m, 2h "
                   "or 1d"));
}

std::string FormatTime(std::int64_t time_ns) {
  return absl::FormatTime("%Y-%m-%dT%H:%M:%E3SZ", absl::FromUnixNanos(time_ns),
                          absl::UTCTimeZone());
}

std::string FormatSeconds(std::int64_t time_ns) {
  const bool negative = time_ns < 0;
  const std::uint64_t size =
      negative ? -static_cast<std::uint64_t>(time_ns) : static_cast<std::uint64_t>(time_ns);
  return absl::StrFormat("%s%d.%09d", negative ? "-" : "", size / 1'000'000'000,
                         size % 1'000'000'000);
}

}  // namespace soundmap::cli
