#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

// How MCAP (https://mcap.dev/spec) lays its records down: <opcode u8><length u64><content>,
// little-endian, strings behind a u32 length.
namespace soundmap::recording {

inline constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);
inline constexpr std::int64_t kRecordHeaderBytes = 9;
inline constexpr std::int64_t kFooterContentBytes = 20;

enum class Opcode : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kAttachment = 0x09,
  kAttachmentIndex = 0x0a,
  kStatistics = 0x0b,
  kMetadata = 0x0c,
  kMetadataIndex = 0x0d,
  kSummaryOffset = 0x0e,
  kDataEnd = 0x0f,
};

// CRC-32 (zlib's) of `bytes` appended to what gave `crc`; 0 to begin.
std::uint32_t ExtendCrc32(std::uint32_t crc, std::string_view bytes);

void AppendU16(std::string& out, std::uint16_t value);
void AppendU32(std::string& out, std::uint32_t value);
void AppendU64(std::string& out, std::uint64_t value);
void AppendString(std::string& out, std::string_view value);

// A record is open from BeginRecord() to EndRecord(), which is given the position that
// BeginRecord() returned.
std::size_t BeginRecord(std::string& out, Opcode opcode);
void EndRecord(std::string& out, std::size_t position);

// Takes fields off the front of a record's content. A field that is not there in full is 0 or
// empty, and ok() is false from then on.
class FieldParser {
 public:
  explicit FieldParser(std::string_view content) : rest_(content) {}

  std::uint8_t U8();
  std::uint16_t U16();
  std::uint32_t U32();
  std::uint64_t U64();
  std::string_view String();                     // behind a u32 length
  std::string_view Bytes(std::uint64_t length);  // the next `length`

  bool ok() const { return ok_; }
  std::string_view rest() const { return rest_; }

 private:
  std::string_view rest_;
  bool ok_ = true;
};

}  // namespace soundmap::recording
