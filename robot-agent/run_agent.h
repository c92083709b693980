#pragma once

#include <string>

#include "absl/status/status.h"

namespace soundmap {

// Records the configured source to the spool and delivers the spool, until all is delivered or
// SIGTERM or SIGINT comes; OK then.
absl::Status RunAgent(const std::string& config_path);

}  // namespace soundmap
