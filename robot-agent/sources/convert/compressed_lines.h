#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "absl/status/status.h"

namespace soundmap::convert {

// Each line of a text file, plain or compressed (gzip, bzip2, xz, zstd, whatever its name is), with
// its number from 1 and without its end. A last line without an end counts too, unless the file is
// damaged. NotFound and the like: the file cannot be read. DataLoss: it is damaged or cut; all
// whole lines before have been given.
absl::Status ForEachLine(const std::string& path,
                         const std::function<void(std::string_view line, int number)>& take);

}  // namespace soundmap::convert
