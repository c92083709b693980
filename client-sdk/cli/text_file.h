#pragma once

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace soundmap::cli {

// The whole file. NotFound, PermissionDenied, InvalidArgument when it is longer than `max_bytes` or
// not a file.
absl::StatusOr<std::string> ReadTextFile(const std::string& path, std::int64_t max_bytes);

// Calls `line(text, where)` for each line that holds something before a `#`, stripped; `where` is
// "FILE:NUMBER" for error sentences. Stops at the first error.
absl::Status ForEachLine(
    const std::string& path,
    const std::function<absl::Status(absl::string_view text, const std::string& where)>& line);

}  // namespace soundmap::cli
