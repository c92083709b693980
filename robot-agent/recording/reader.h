#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "recording/message.h"

namespace soundmap::recording {

struct ReaderLimits {
  std::int64_t max_record_bytes = 64 << 20;  // a longer schema, channel or message is damage
  std::int64_t max_chunk_uncompressed_bytes =
      256 << 20;  // and so is a chunk that is longer, packed or unpacked
};

// Reads an MCAP file from front to back, in the order of the file; a summary is not needed. Memory
// is bounded by the largest chunk. Every CRC that the file has is checked: a chunk's before its
// first message is delivered, the whole file's at its end. A chunk that is cut or fails its CRC is
// damage as a whole. Records of unknown kind are skipped. Messages stand either all in chunks or
// all outside.
class Reader {
 public:
  // NotFound, PermissionDenied; InvalidArgument when it is not an MCAP file.
  static absl::StatusOr<std::unique_ptr<Reader>> Open(const std::string& path,
                                                      const ReaderLimits& limits = {});

  // The next message; none at the end. After damage (a cut, a bad CRC, a length that cannot be)
  // everything before it has been delivered and the status is DataLoss with a sentence that names
  // the file, the byte position and what is wrong; it stays so. A file that was never closed is cut
  // after its last whole record, and so is damaged there.
  absl::StatusOr<std::optional<Message>> Next();

  // The file has grown: what was appended belongs to it. Not after damage.
  absl::Status TakeGrowth();

  // Bytes of the file that were read, and its size.
  std::int64_t position_bytes() const { return position_bytes_; }
  std::int64_t size_bytes() const { return size_bytes_; }

 private:
  // What a repetition of a schema or channel record must equal.
  struct Fingerprint {
    std::size_t bytes = 0;
    std::uint32_t crc = 0;
    bool operator==(const Fingerprint&) const = default;
  };
  struct Schema {
    Fingerprint fingerprint;
    std::string name;
  };
  struct Channel {
    Fingerprint fingerprint;
    std::string topic;
    std::string schema;
    std::string encoding;
  };
  enum class Section { kStart, kData, kSummary, kEnd };
  struct CloseFile {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };

  Reader(std::string path, std::FILE* file, std::int64_t size_bytes, const ReaderLimits& limits);

  // One record of the chunk at hand, or of the file; its message if it is one.
  absl::StatusOr<std::optional<Message>> NextInChunk();
  absl::StatusOr<std::optional<Message>> NextInFile();

  absl::Status OpenChunk();
  absl::Status AddSchema(std::string_view content);
  absl::Status AddChannel(std::string_view content);
  absl::StatusOr<Message> ParseMessage(std::string_view content) const;
  absl::Status CheckMessageIndex(std::uint64_t content_bytes);
  absl::Status SkipAttachment(std::uint64_t content_bytes);
  absl::Status EndData(std::uint32_t data_crc);
  absl::Status EndFile(std::uint32_t summary_crc);

  absl::Status ReadContent(std::uint64_t bytes, std::int64_t limit_bytes);
  absl::Status Skip(std::uint64_t bytes);
  absl::Status ReadBytes(char* out, std::size_t bytes);
  // Of the record at hand.
  absl::Status Damage(std::string_view what) const;

  const std::string path_;
  const std::unique_ptr<std::FILE, CloseFile> file_;
  std::int64_t size_bytes_;
  const ReaderLimits limits_;

  absl::Status status_;
  Section section_ = Section::kStart;
  std::int64_t position_bytes_ = 0;
  std::int64_t record_position_bytes_ = 0;   // of the record at hand
  std::int64_t summary_position_bytes_ = 0;  // behind the data section
  std::uint32_t crc_ = 0;  // of the file up to the position; in the summary, of the summary
  std::string content_;    // of the record at hand

  bool has_chunks_ = false;
  std::string chunk_;  // unpacked
  std::string_view chunk_rest_;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Channel> channels_;
};

}  // namespace soundmap::recording
