#include "recording/reader.h"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "recording/chunk_codec.h"
#include "recording/wire.h"

namespace soundmap::recording {
namespace {

constexpr std::size_t kFileBufferBytes = 1 << 16;
constexpr std::size_t kSkipBytes = 1 << 16;
constexpr std::int64_t kChunkFieldBytes = 1 << 12;  // more than a chunk's own fields take
constexpr std::size_t kMaxNameBytes = 1024;

// A record of this opcode, as the sentences call it.
std::string Kind(std::uint8_t opcode) {
  switch (static_cast<Opcode>(opcode)) {
    case Opcode::kSchema:
      return "a schema";
    case Opcode::kChannel:
      return "a channel";
    case Opcode::kMessage:
      return "a message";
    case Opcode::kChunk:
      return "a chunk";
    case Opcode::kMessageIndex:
      return "a message index";
    case Opcode::kAttachment:
      return "an attachment";
    case Opcode::kFooter:
      return "a footer";
    default:
      return absl::StrCat("a record of kind 0x", absl::Hex(opcode, absl::kZeroPad2));
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<Reader>> Reader::Open(const std::string& path,
                                                     const ReaderLimits& limits) {
  std::FILE* file = std::fopen(path.c_str(), "rbe");
  if (file == nullptr) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot open '", path, "'"));
  }
  struct stat attributes;
  const bool regular = ::fstat(::fileno(file), &attributes) == 0 && S_ISREG(attributes.st_mode);
  std::unique_ptr<Reader> reader(new Reader(path, file, regular ? attributes.st_size : 0, limits));
  if (!regular) return absl::InvalidArgumentError(absl::StrCat("'", path, "' is not a file"));
  std::array<char, kMagic.size()> magic{};
  const std::string_view magic_bytes(magic.data(), magic.size());
  if (reader->size_bytes_ < static_cast<std::int64_t>(magic.size())) {
    return absl::InvalidArgumentError(
        absl::StrCat("'", path, "' is not an MCAP file: it has ", reader->size_bytes_, " bytes"));
  }
  if (absl::Status status = reader->ReadBytes(magic.data(), magic.size()); !status.ok()) {
    return status;
  }
  if (magic_bytes == kMagic) return reader;
  if (magic_bytes.substr(0, 5) == kMagic.substr(0, 5)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "'", path, "' is of another version of MCAP than this program reads, which is 0"));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("'", path, "' is not an MCAP file: it does not begin like one"));
}

Reader::Reader(std::string path, std::FILE* file, std::int64_t size_bytes,
               const ReaderLimits& limits)
    : path_(std::move(path)), file_(file), size_bytes_(size_bytes), limits_(limits) {
  std::setvbuf(file, nullptr, _IOFBF, kFileBufferBytes);
}

absl::StatusOr<std::optional<Message>> Reader::Next() {
  while (status_.ok()) {
    if (chunk_rest_.empty() && section_ == Section::kEnd) return std::nullopt;
    absl::StatusOr<std::optional<Message>> message =
        chunk_rest_.empty() ? NextInFile() : NextInChunk();
    if (message.ok() && !*message) continue;
    if (message.ok()) return message;
    status_ = message.status();
  }
  return status_;
}

absl::Status Reader::TakeGrowth() {
  struct stat attributes;
  if (::fstat(::fileno(file_.get()), &attributes) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot read '", path_, "'"));
  }
  size_bytes_ = std::max<std::int64_t>(size_bytes_, attributes.st_size);
  return absl::OkStatus();
}

absl::StatusOr<std::optional<Message>> Reader::NextInChunk() {
  FieldParser record(chunk_rest_);
  const std::uint8_t opcode = record.U8();
  const std::uint64_t content_bytes = record.U64();
  const std::string_view content = record.Bytes(content_bytes);
  if (!record.ok()) return Damage("a record in this chunk does not end inside it");
  chunk_rest_ = record.rest();
  switch (static_cast<Opcode>(opcode)) {
    case Opcode::kSchema:
      if (absl::Status status = AddSchema(content); !status.ok()) return status;
      return std::nullopt;
    case Opcode::kChannel:
      if (absl::Status status = AddChannel(content); !status.ok()) return status;
      return std::nullopt;
    case Opcode::kMessage:
      return ParseMessage(content);
    default:
      if (opcode > static_cast<std::uint8_t>(Opcode::kDataEnd)) return std::nullopt;
      return Damage(absl::StrCat(Kind(opcode), " stands in this chunk"));
  }
}

absl::StatusOr<std::optional<Message>> Reader::NextInFile() {
  record_position_bytes_ = position_bytes_;
  const std::uint32_t crc_before = crc_;
  const std::int64_t rest_bytes = size_bytes_ - position_bytes_;
  if (rest_bytes == 0) return Damage("the file ends here without being closed");
  if (rest_bytes < kRecordHeaderBytes) return Damage("the file is cut off here");
  std::array<char, kRecordHeaderBytes> header;
  if (absl::Status status = ReadBytes(header.data(), header.size()); !status.ok()) return status;
  FieldParser fields(std::string_view(header.data(), header.size()));
  const std::uint8_t kind = fields.U8();
  const auto opcode = static_cast<Opcode>(kind);
  const std::uint64_t content_bytes = fields.U64();
  if (content_bytes > static_cast<std::uint64_t>(size_bytes_ - position_bytes_)) {
    return Damage(absl::StrCat(Kind(kind), " of ", content_bytes, " bytes is cut off after ",
                               size_bytes_ - position_bytes_));
  }

  if (section_ == Section::kStart && opcode != Opcode::kHeader) {
    return Damage("the file does not start with a header record");
  }
  if (section_ == Section::kSummary && opcode != Opcode::kFooter) {
    if (absl::Status status = Skip(content_bytes); !status.ok()) return status;
    return std::nullopt;
  }
  absl::Status status;
  switch (opcode) {
    case Opcode::kHeader:
      if (section_ != Section::kStart) return Damage("a second header record");
      section_ = Section::kData;
      status = Skip(content_bytes);
      break;
    case Opcode::kSchema:
      status = ReadContent(content_bytes, limits_.max_record_bytes);
      if (status.ok()) status = AddSchema(content_);
      break;
    case Opcode::kChannel:
      status = ReadContent(content_bytes, limits_.max_record_bytes);
      if (status.ok()) status = AddChannel(content_);
      break;
    case Opcode::kMessage:
      // Without a CRC: in a chunked file most likely a message index whose kind was damaged.
      if (has_chunks_) return Damage("a message stands outside of the chunks");
      status = ReadContent(content_bytes, limits_.max_record_bytes);
      if (status.ok()) return ParseMessage(content_);
      break;
    case Opcode::kChunk:
      status = ReadContent(content_bytes, limits_.max_chunk_uncompressed_bytes + kChunkFieldBytes);
      if (status.ok()) status = OpenChunk();
      break;
    case Opcode::kMessageIndex:
      status = CheckMessageIndex(content_bytes);
      break;
    case Opcode::kAttachment:
      status = SkipAttachment(content_bytes);
      break;
    case Opcode::kDataEnd:
      status = ReadContent(content_bytes, limits_.max_record_bytes);
      if (status.ok()) status = EndData(crc_before);
      break;
    case Opcode::kFooter: {
      status = ReadContent(content_bytes, kFooterContentBytes);
      if (!status.ok()) break;
      std::uint32_t crc = section_ == Section::kSummary ? crc_before : 0;
      crc = ExtendCrc32(crc, std::string_view(header.data(), header.size()));
      status = EndFile(ExtendCrc32(crc, std::string_view(content_).substr(0, 16)));
      break;
    }
    case Opcode::kChunkIndex:
    case Opcode::kAttachmentIndex:
    case Opcode::kStatistics:
    case Opcode::kMetadataIndex:
    case Opcode::kSummaryOffset:
      return Damage(absl::StrCat(Kind(kind), " stands among the data"));
    default:
      if (kind == 0) return Damage("a record of kind 0x00");
      status = Skip(content_bytes);
  }
  if (!status.ok()) return status;
  return std::nullopt;
}

absl::Status Reader::OpenChunk() {
  FieldParser fields(content_);
  fields.U64();  // first and last time
  fields.U64();
  const std::uint64_t uncompressed_bytes = fields.U64();
  const std::uint32_t crc = fields.U32();
  const std::string_view compression = fields.String();
  const std::uint64_t data_bytes = fields.U64();
  const std::string_view data = fields.Bytes(data_bytes);
  if (!fields.ok()) return Damage("the fields of this chunk do not fit into it");
  if (uncompressed_bytes > static_cast<std::uint64_t>(limits_.max_chunk_uncompressed_bytes)) {
    return Damage(absl::StrCat("this chunk declares ", uncompressed_bytes, " bytes unpacked; ",
                               limits_.max_chunk_uncompressed_bytes, " are allowed"));
  }
  if (absl::Status status = DecompressChunk(compression, data, uncompressed_bytes, chunk_);
      !status.ok()) {
    return Damage(absl::StrCat("this chunk cannot be unpacked: ", status.message()));
  }
  if (crc != 0 && crc != ExtendCrc32(0, chunk_)) return Damage("this chunk fails its CRC");
  chunk_rest_ = chunk_;
  has_chunks_ = true;
  return absl::OkStatus();
}

absl::Status Reader::AddSchema(std::string_view content) {
  FieldParser fields(content);
  const std::uint16_t id = fields.U16();
  const std::string_view name = fields.String();
  fields.String();  // encoding
  fields.String();  // data
  if (!fields.ok()) return Damage("the fields of a schema record do not fit into it");
  if (id == 0) return absl::OkStatus();
  if (name.size() > kMaxNameBytes) return Damage("the name of a schema is too long");
  const Fingerprint fingerprint{content.size(), ExtendCrc32(0, content)};
  const auto [schema, added] = schemas_.try_emplace(id, Schema{fingerprint, std::string(name)});
  if (!added && schema->second.fingerprint != fingerprint) {
    return Damage(absl::StrCat("schema ", id, " is declared a second time, differently"));
  }
  return absl::OkStatus();
}

absl::Status Reader::AddChannel(std::string_view content) {
  FieldParser fields(content);
  const std::uint16_t id = fields.U16();
  const std::uint16_t schema_id = fields.U16();
  const std::string_view topic = fields.String();
  const std::string_view encoding = fields.String();
  fields.String();  // metadata
  if (!fields.ok()) return Damage("the fields of a channel record do not fit into it");
  if (topic.size() > kMaxNameBytes || encoding.size() > kMaxNameBytes) {
    return Damage("the name of a channel is too long");
  }
  const auto schema = schemas_.find(schema_id);
  if (schema_id != 0 && schema == schemas_.end()) {
    return Damage(absl::StrCat("channel ", id, " names a schema, ", schema_id,
                               ", that is not declared before it"));
  }
  const Fingerprint fingerprint{content.size(), ExtendCrc32(0, content)};
  const auto [channel, added] = channels_.try_emplace(
      id, Channel{fingerprint, std::string(topic),
                  schema_id == 0 ? std::string() : schema->second.name, std::string(encoding)});
  if (!added && channel->second.fingerprint != fingerprint) {
    return Damage(absl::StrCat("channel ", id, " is declared a second time, differently"));
  }
  return absl::OkStatus();
}

absl::StatusOr<Message> Reader::ParseMessage(std::string_view content) const {
  FieldParser fields(content);
  const std::uint16_t channel_id = fields.U16();
  const std::uint32_t sequence = fields.U32();
  const std::uint64_t log_time_ns = fields.U64();
  const std::uint64_t publish_time_ns = fields.U64();
  const std::string_view data = fields.rest();
  if (!fields.ok()) return Damage("the fields of a message do not fit into it");
  if (static_cast<std::int64_t>(data.size()) > limits_.max_record_bytes) {
    return Damage(absl::StrCat("a message has ", data.size(), " bytes; ", limits_.max_record_bytes,
                               " are allowed"));
  }
  const auto channel = channels_.find(channel_id);
  if (channel == channels_.end()) {
    return Damage(absl::StrCat("a message names a channel, ", channel_id,
                               ", that is not declared before it"));
  }
  constexpr std::uint64_t kMaxTimeNs = std::numeric_limits<std::int64_t>::max();
  if (log_time_ns > kMaxTimeNs || publish_time_ns > kMaxTimeNs) {
    return Damage(
        absl::StrCat("a message on ", channel->second.topic, " has a time beyond the year 2262"));
  }
  Message message;
  message.topic = channel->second.topic;
  message.schema = channel->second.schema;
  message.encoding = channel->second.encoding;
  message.log_time_ns = static_cast<std::int64_t>(log_time_ns);
  message.publish_time_ns = static_cast<std::int64_t>(publish_time_ns);
  message.sequence = sequence;
  message.data = data;
  return message;
}

// A chunk whose kind was damaged into this one must not pass as an index, nor an index whose length
// was damaged hide what follows: fields behind the entries, which a later MCAP might add, are
// refused.
absl::Status Reader::CheckMessageIndex(std::uint64_t content_bytes) {
  constexpr std::uint64_t kFixedBytes = 6;
  if (content_bytes < kFixedBytes) return Damage("this message index is too short");
  if (absl::Status status = ReadContent(kFixedBytes, kFixedBytes); !status.ok()) return status;
  FieldParser fields(content_);
  const bool known = channels_.count(fields.U16()) > 0;
  const std::uint32_t entry_bytes = fields.U32();
  if (!known || entry_bytes != content_bytes - kFixedBytes || entry_bytes % 16 != 0) {
    return Damage("this message index does not hold together");
  }
  return Skip(content_bytes - kFixedBytes);
}

absl::Status Reader::SkipAttachment(std::uint64_t content_bytes) {
  constexpr std::uint64_t kCrcBytes = 4;
  if (content_bytes < kCrcBytes) return Damage("this attachment is too short");
  std::uint32_t attachment_crc = 0;
  std::array<char, kSkipBytes> bytes;
  for (std::uint64_t rest = content_bytes - kCrcBytes; rest > 0;) {
    const std::size_t step = std::min<std::uint64_t>(rest, bytes.size());
    if (absl::Status status = ReadBytes(bytes.data(), step); !status.ok()) return status;
    attachment_crc = ExtendCrc32(attachment_crc, std::string_view(bytes.data(), step));
    rest -= step;
  }
  if (absl::Status status = ReadContent(kCrcBytes, kCrcBytes); !status.ok()) return status;
  const std::uint32_t crc = FieldParser(content_).U32();
  if (crc != 0 && crc != attachment_crc) return Damage("this attachment fails its CRC");
  return absl::OkStatus();
}

absl::Status Reader::EndData(std::uint32_t data_crc) {
  FieldParser fields(content_);
  const std::uint32_t crc = fields.U32();
  if (!fields.ok()) return Damage("this end of the data is too short");
  if (crc != 0 && crc != data_crc) return Damage("the data before this fail their CRC");
  section_ = Section::kSummary;
  summary_position_bytes_ = position_bytes_;
  crc_ = 0;
  return absl::OkStatus();
}

absl::Status Reader::EndFile(std::uint32_t summary_crc) {
  FieldParser fields(content_);
  const auto summary_position = static_cast<std::int64_t>(fields.U64());
  fields.U64();  // the position of the summary offsets
  const std::uint32_t crc = fields.U32();
  if (!fields.ok()) return Damage("the footer is too short");
  if (summary_position != 0 && summary_position != summary_position_bytes_) {
    return Damage("the footer names a summary that is not there");
  }
  if (crc != 0 && crc != summary_crc) return Damage("the summary before this fails its CRC");
  if (size_bytes_ - position_bytes_ != static_cast<std::int64_t>(kMagic.size())) {
    return Damage(size_bytes_ - position_bytes_ < static_cast<std::int64_t>(kMagic.size())
                      ? "the file is cut off behind its footer"
                      : "bytes follow the end of the file's footer");
  }
  if (absl::Status status = ReadContent(kMagic.size(), kMagic.size()); !status.ok()) return status;
  if (content_ != kMagic) return Damage("the file does not end like an MCAP file");
  section_ = Section::kEnd;
  return absl::OkStatus();
}

absl::Status Reader::ReadContent(std::uint64_t bytes, std::int64_t limit_bytes) {
  if (bytes > static_cast<std::uint64_t>(limit_bytes)) {
    return Damage(absl::StrCat("this record has ", bytes, " bytes; ", limit_bytes, " are allowed"));
  }
  content_.resize(bytes);
  return ReadBytes(content_.data(), content_.size());
}

absl::Status Reader::Skip(std::uint64_t bytes) {
  std::array<char, kSkipBytes> skipped;
  while (bytes > 0) {
    const std::size_t step = std::min<std::uint64_t>(bytes, skipped.size());
    if (absl::Status status = ReadBytes(skipped.data(), step); !status.ok()) return status;
    bytes -= step;
  }
  return absl::OkStatus();
}

absl::Status Reader::ReadBytes(char* out, std::size_t bytes) {
  const std::size_t read = std::fread(out, 1, bytes, file_.get());
  crc_ = ExtendCrc32(crc_, std::string_view(out, read));
  position_bytes_ += static_cast<std::int64_t>(read);
  if (read == bytes) return absl::OkStatus();
  if (std::ferror(file_.get()) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot read '", path_, "'"));
  }
  return Damage("the file was cut while it was read");
}

absl::Status Reader::Damage(std::string_view what) const {
  return absl::DataLossError(absl::StrCat("'", path_, "' is damaged at byte ",
                                          record_position_bytes_, ": ", std::string(what)));
}

}  // namespace soundmap::recording
