#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"

// Times as people write them. Times are nanoseconds since the Unix epoch, UTC unless the text says
// otherwise.
namespace soundmap::cli {

// ISO 8601 ("2024-05-01T12:00:00Z", "2024-05-01 12:00", "2024-05-01"), seconds since the epoch
// ("1714564800.5"), or how long before `now_ns` ("90s", "10m", "2h", "1d", also with " ago").
absl::StatusOr<std::int64_t> ParseSince(const std::string& text, std::int64_t now_ns);

// "2024-05-01T12:00:00.250Z", to the millisecond.
std::string FormatTime(std::int64_t time_ns);

// "1714564800.250000000": seconds since the epoch, exact.
std::string FormatSeconds(std::int64_t time_ns);

}  // namespace soundmap::cli
