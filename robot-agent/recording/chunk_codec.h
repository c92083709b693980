#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/status.h"

namespace soundmap::recording {

enum class Compression { kNone, kLz4, kZstd };

// As a chunk names it: "", "lz4" (frame format), "zstd".
std::string_view CompressionName(Compression compression);

// Compresses `records` onto the end of `out`. Internal: the codec failed.
absl::Status CompressChunk(Compression compression, std::string_view records, std::string& out);

// Makes `records` the `uncompressed_bytes` bytes that `data` stands for; exactly so many, or
// DataLoss with half a sentence on what is wrong.
absl::Status DecompressChunk(std::string_view compression, std::string_view data,
                             std::uint64_t uncompressed_bytes, std::string& records);

}  // namespace soundmap::recording
