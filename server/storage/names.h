#pragma once

#include <string_view>

#include "absl/status/status.h"

namespace soundmap::storage {

// Names of sites, sessions, robots and the like are 1-63 of [a-z0-9_-] and start with a letter or a
// digit, so that they are safe as names of files and as parts of keys. InvalidArgument otherwise;
// `what` ("site") stands in the sentence.
absl::Status ValidateName(std::string_view what, std::string_view name);

// Up to four names joined by '/'.
absl::Status ValidateRecordKey(std::string_view key);

}  // namespace soundmap::storage
