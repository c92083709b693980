#pragma once

#include <string>

#include "absl/status/status.h"

namespace soundmap::storage {

// What the file FORMAT of a data folder says.
std::string FormatText();

// NotFound: the folder has no file FORMAT. FailedPrecondition: a newer version wrote it. DataLoss:
// the file says something else.
absl::Status CheckFormat(const std::string& data_dir);

}  // namespace soundmap::storage
