#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "recording/chunk_codec.h"

namespace soundmap::recording {

struct WriterOptions {
  Compression compression = Compression::kZstd;
  std::int64_t chunk_bytes = 1 << 20;  // a chunk is closed when its uncompressed records reach this
  bool chunked = true;                 // false: messages stand in the data section themselves
  bool summary = true;  // message and chunk indexes, schemas, channels and statistics
};

// Writes an MCAP file (profile empty, library "soundmap"). Schemas are serialized
// FileDescriptorSets of the Foxglove messages. One thread at a time. An error of Write(), Flush()
// or Close() on the file stays: the file has been cut back to its last whole chunk, and what was
// written since the last successful Flush() may be lost.
class Writer {
 public:
  // Creates the file; FailedPrecondition if it exists and is not empty, otherwise the errno's
  // status and sentence.
  static absl::StatusOr<std::unique_ptr<Writer>> Create(const std::string& path,
                                                        const WriterOptions& options);
  // A file that was not closed ends after its last whole chunk: readers read up to there.
  ~Writer();

  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  // `schema` is a Foxglove message name that this library knows ("foxglove.RawAudio"); a topic has
  // one schema. `data` is the serialized message. InvalidArgument (nothing is written, the writer
  // goes on) for an unknown schema, a topic that has another one, a time before 1970;
  // ResourceExhausted when the disk is full.
  absl::Status Write(std::string_view topic, std::string_view schema, std::int64_t log_time_ns,
                     std::uint32_t sequence, std::string_view data);

  // Closes the chunk at hand and hands all bytes to the operating system; with `sync`, to the disk
  // (fdatasync).
  absl::Status Flush(bool sync);

  // Flushes, writes the summary and footer and closes the file. Write() is an error afterwards.
  absl::Status Close();

  // Bytes of the file so far, without the chunk at hand.
  std::int64_t size_bytes() const { return size_bytes_; }

 private:
  struct Channel {
    std::uint16_t id = 0;
    std::string schema;
    std::uint64_t message_count = 0;
  };
  struct TimeRange {
    std::uint64_t first_ns = 0;
    std::uint64_t last_ns = 0;
    bool empty = true;
    void Add(std::uint64_t time_ns);
  };
  // Of one channel in the chunk at hand: time and offset of each message.
  using MessageIndex = std::vector<std::pair<std::uint64_t, std::uint64_t>>;

  Writer(std::string path, int file, const WriterOptions& options);

  absl::StatusOr<Channel*> FindOrAddChannel(std::string_view topic, std::string_view schema);
  absl::Status CloseChunk();
  absl::Status Emit(std::string_view bytes);
  std::string Summary() const;

  const std::string path_;
  const WriterOptions options_;
  int file_;  // -1: closed
  absl::Status status_;
  std::int64_t size_bytes_ = 0;
  std::uint32_t file_crc_ = 0;

  std::map<std::string, Channel, std::less<>> channels_;       // by topic
  std::map<std::string, std::uint16_t, std::less<>> schemas_;  // id by name
  TimeRange file_times_;

  // The records at hand: of the chunk, or, without chunks, that are not yet in the file.
  std::string records_;
  TimeRange chunk_times_;
  std::map<std::uint16_t, MessageIndex> chunk_index_;  // by channel
  std::string chunk_;                                  // kept for its memory

  // Records for the summary.
  std::string schema_records_;
  std::string channel_records_;
  std::string chunk_index_records_;
  std::uint32_t chunk_count_ = 0;
};

}  // namespace soundmap::recording
