#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::recording {

enum class Compression { kNone, kLz4, kZstd };

struct WriterOptions {
  Compression compression = Compression::kZstd;
  std::int64_t chunk_bytes = 1 << 20;  // a chunk is closed when its uncompressed records reach this
  bool chunked = true;                 // false: messages stand in the data section themselves
  bool summary = true;                 // schemas, channels, chunk indexes and statistics after the data
};

// Writes an MCAP file (profile empty, library "soundmap"). Schemas are serialized FileDescriptorSets of the Foxglove messages. One thread at a time.
class Writer {
 public:
  // Creates the file; FailedPrecondition if it exists and is not empty, otherwise the errno's status and sentence.
  static absl::StatusOr<std::unique_ptr<Writer>> Create(const std::string& path,
                                                        const WriterOptions& options);
  // A file that was not closed ends after its last whole chunk: readers read up to there.
  virtual ~Writer() = default;

  // `schema` is a Foxglove message name that this library knows ("foxglove.RawAudio"); a topic has one schema. `data` is the
  // serialized message. ResourceExhausted when the disk is full.
  virtual absl::Status Write(std::string_view topic, std::string_view schema,
                             std::int64_t log_time_ns, std::uint32_t sequence,
                             std::string_view data) = 0;

  // Closes the chunk at hand and hands all bytes to the operating system; with `sync`, to the disk (fdatasync).
  virtual absl::Status Flush(bool sync) = 0;

  // Flushes, writes the summary and footer and closes the file. Write() is an error afterwards.
  virtual absl::Status Close() = 0;
};

}  // namespace soundmap::recording
