#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "recording/message.h"

namespace soundmap::recording {

struct ReaderLimits {
  std::int64_t max_record_bytes = 64 << 20;  // a longer record is damage
  std::int64_t max_chunk_uncompressed_bytes = 256 << 20;
};

// Reads an MCAP file from front to back, in the order of the file; a summary is not needed. Memory is bounded by the largest chunk.
class Reader {
 public:
  // NotFound, PermissionDenied; InvalidArgument when it is not an MCAP file.
  static absl::StatusOr<std::unique_ptr<Reader>> Open(const std::string& path,
                                                      const ReaderLimits& limits = {});
  virtual ~Reader() = default;

  // The next message; none at the end. After damage (a cut, a bad CRC, a length that cannot be) everything before it has been delivered
  // and the status is DataLoss with a sentence that names the file, the byte position and what is wrong; it stays so.
  virtual absl::StatusOr<std::optional<Message>> Next() = 0;

  // Bytes of the file that were read, and its size.
  virtual std::int64_t position_bytes() const = 0;
  virtual std::int64_t size_bytes() const = 0;
};

}  // namespace soundmap::recording
