#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "recording/reader.h"
#include "recording/wire.h"
#include "recording/writer.h"
#include "tests/recording/recording_files.h"

namespace soundmap::recording {
namespace {

using testing::HasSubstr;

// A small file in which every `per_chunk` messages were flushed.
struct SmallFile {
  std::string bytes;
  std::vector<Message> messages;
  std::vector<std::size_t>
      readable_from;  // message i can be delivered once so many bytes are there
  std::vector<std::size_t> chunk_begin;
};

SmallFile MakeSmallFile(const WriterOptions& options, int per_chunk) {
  SmallFile file;
  file.messages = SomeMessages(12);
  const std::string path = FreshPath("small");
  auto writer = Writer::Create(path, options).value();
  for (std::size_t i = 0; i < file.messages.size(); i += per_chunk) {
    file.chunk_begin.push_back(writer->size_bytes());
    for (int j = 0; j < per_chunk; ++j) {
      const Message& message = file.messages[i + j];
      EXPECT_TRUE(writer
                      ->Write(message.topic, message.schema, message.log_time_ns, message.sequence,
                              message.data)
                      .ok());
    }
    EXPECT_TRUE(writer->Flush(false).ok());
    // The message indexes behind a chunk are not needed.
    const std::string chunk = FileBytes(path).substr(file.chunk_begin.back() + 1, 8);
    const std::size_t end =
        options.chunked ? file.chunk_begin.back() + kRecordHeaderBytes + FieldParser(chunk).U64()
                        : writer->size_bytes();
    file.readable_from.insert(file.readable_from.end(), per_chunk, end);
  }
  EXPECT_TRUE(writer->Close().ok());
  file.bytes = FileBytes(path);
  return file;
}

std::vector<WriterOptions> Layouts() {
  std::vector<WriterOptions> layouts;
  for (const bool chunked : {true, false}) {
    for (const bool summary : {true, false}) {
      for (const Compression c : {Compression::kNone, Compression::kLz4, Compression::kZstd}) {
        if (!chunked && c != Compression::kNone) continue;
        layouts.push_back({.compression = c, .chunked = chunked, .summary = summary});
      }
    }
  }
  return layouts;
}

std::string Describe(const WriterOptions& options) {
  return std::string(CompressionName(options.compression)) +
         (options.chunked ? " chunked" : " plain") + (options.summary ? " summary" : "");
}

bool IsPrefix(const std::vector<Message>& part, const std::vector<Message>& whole) {
  return part.size() <= whole.size() && std::equal(part.begin(), part.end(), whole.begin());
}

bool IsSubsequence(const std::vector<Message>& part, const std::vector<Message>& whole) {
  auto next = whole.begin();
  for (const Message& message : part) {
    next = std::find(next, whole.end(), message);
    if (next == whole.end()) return false;
    ++next;
  }
  return true;
}

class FlippableFile {
 public:
  explicit FlippableFile(const std::string& bytes) : bytes_(bytes), path_(FreshPath("flipped")) {
    WriteFileBytes(path_, bytes_);
  }
  Delivered ReadWithFlipped(std::size_t bit) const {
    SetByte(bit / 8, static_cast<char>(bytes_[bit / 8] ^ (1 << bit % 8)));
    Delivered delivered = ReadAll(path_);
    SetByte(bit / 8, bytes_[bit / 8]);
    return delivered;
  }

 private:
  void SetByte(std::size_t position, char value) const {
    std::fstream file(path_, std::ios::binary | std::ios::in | std::ios::out);
    file.seekp(static_cast<std::streamoff>(position)).put(value);
  }

  std::string bytes_;
  std::string path_;
};

TEST(Damage, CutAtEveryByteDeliversAllBeforeTheCut) {
  for (const WriterOptions& options : Layouts()) {
    SCOPED_TRACE(Describe(options));
    const SmallFile file = MakeSmallFile(options, options.chunked ? 3 : 1);
    const std::string path = FreshPath("cut");
    WriteFileBytes(path, file.bytes);
    for (std::size_t cut = file.bytes.size(); cut-- > 0;) {
      std::filesystem::resize_file(path, cut);
      const Delivered delivered = ReadAll(path);
      ASSERT_EQ(delivered.status.code(), cut < kMagic.size() ? absl::StatusCode::kInvalidArgument
                                                             : absl::StatusCode::kDataLoss)
          << "cut at " << cut << ": " << delivered.status;
      ASSERT_THAT(std::string(delivered.status.message()), HasSubstr(path));
      const auto expected = std::count_if(file.readable_from.begin(), file.readable_from.end(),
                                          [cut](std::size_t from) { return from <= cut; });
      ASSERT_EQ(static_cast<std::ptrdiff_t>(delivered.messages.size()), expected)
          << "cut at " << cut;
      ASSERT_TRUE(IsPrefix(delivered.messages, file.messages)) << "cut at " << cut;
    }
  }
}

TEST(Damage, NoFlippedBitOfAChunkedFileDeliversAWrongMessage) {
  for (const WriterOptions& options : Layouts()) {
    if (!options.chunked) continue;
    SCOPED_TRACE(Describe(options));
    const SmallFile file = MakeSmallFile(options, 3);
    const FlippableFile flippable(file.bytes);
    for (std::size_t bit = 0; bit < file.bytes.size() * 8; ++bit) {
      const Delivered delivered = flippable.ReadWithFlipped(bit);
      if (delivered.status.ok()) {
        // The end of the data lost its kind, and with it the CRC.
        ASSERT_EQ(delivered.messages, file.messages) << "bit " << bit;
        continue;
      }
      // A chunk whose kind has become an unknown one is skipped; the file's CRC tells in the end.
      const bool kind_of_chunk = std::find(file.chunk_begin.begin(), file.chunk_begin.end(),
                                           bit / 8) != file.chunk_begin.end();
      ASSERT_TRUE(kind_of_chunk ? IsSubsequence(delivered.messages, file.messages)
                                : IsPrefix(delivered.messages, file.messages))
          << "bit " << bit << ": " << delivered.status;
    }
  }
}

TEST(Damage, AFlippedBitOfAPlainFileIsToldAtTheEnd) {
  const SmallFile file = MakeSmallFile({.chunked = false}, 1);
  const FlippableFile flippable(file.bytes);
  for (std::size_t bit = kMagic.size() * 8; bit < file.readable_from.back() * 8; ++bit) {
    ASSERT_EQ(flippable.ReadWithFlipped(bit).status.code(), absl::StatusCode::kDataLoss)
        << "bit " << bit;
  }
}

std::string Head() {
  std::string bytes(kMagic);
  const std::size_t header = BeginRecord(bytes, Opcode::kHeader);
  AppendString(bytes, "");
  AppendString(bytes, "test");
  EndRecord(bytes, header);
  return bytes;
}

std::string Record(std::uint8_t opcode, std::string_view content) {
  std::string bytes;
  const std::size_t record = BeginRecord(bytes, static_cast<Opcode>(opcode));
  bytes.append(content);
  EndRecord(bytes, record);
  return bytes;
}

std::string Chunk(std::string_view compression, std::uint64_t uncompressed_bytes, std::uint32_t crc,
                  std::uint64_t declared_bytes, std::string_view data) {
  std::string content;
  AppendU64(content, 0);
  AppendU64(content, 0);
  AppendU64(content, uncompressed_bytes);
  AppendU32(content, crc);
  AppendString(content, compression);
  AppendU64(content, declared_bytes);
  content.append(data);
  return Record(0x06, content);
}

std::string Schema(std::uint16_t id, std::string_view name) {
  std::string content;
  AppendU16(content, id);
  AppendString(content, name);
  AppendString(content, "protobuf");
  AppendString(content, "");
  return Record(0x03, content);
}

std::string Channel(std::uint16_t id, std::uint16_t schema, std::string_view topic) {
  std::string content;
  AppendU16(content, id);
  AppendU16(content, schema);
  AppendString(content, topic);
  AppendString(content, "protobuf");
  AppendU32(content, 0);
  return Record(0x04, content);
}

std::string MessageRecord(std::uint16_t channel, std::uint64_t time_ns, std::string_view data) {
  std::string content;
  AppendU16(content, channel);
  AppendU32(content, 0);
  AppendU64(content, time_ns);
  AppendU64(content, time_ns);
  content.append(data);
  return Record(0x05, content);
}

std::string End() {
  std::string bytes = Record(0x0f, std::string(4, '\0'));
  bytes += Record(0x02, std::string(20, '\0'));
  return bytes.append(kMagic);
}

Delivered ReadBytes(const std::string& bytes, const ReaderLimits& limits = {}) {
  const std::string path = FreshPath("crafted");
  WriteFileBytes(path, bytes);
  return ReadAll(path, limits);
}

TEST(Damage, LengthsThatCannotBeAreRefused) {
  const std::string good = Head() + Schema(1, "s") + Channel(1, 1, "/t") + MessageRecord(1, 9, "d");
  ASSERT_TRUE(ReadBytes(good + End()).status.ok()) << ReadBytes(good + End()).status;

  std::string endless = "\x05";
  endless += std::string(8, '\xff');
  std::string long_string = Record(0x03, std::string("\x02\0\xff\xff\xff\xff", 6));
  const std::string zeros(1 << 20, '\0');
  std::string bomb(ZSTD_compressBound(zeros.size()), '\0');
  bomb.resize(ZSTD_compress(bomb.data(), bomb.size(), zeros.data(), zeros.size(), 1));

  const std::pair<const char*, std::string> cases[] = {
      {"a record of 2^64 bytes", endless},
      {"a string longer than its record", long_string},
      {"a chunk of 2^63 bytes unpacked", Chunk("zstd", 1ull << 63, 0, 4, "data")},
      {"a chunk whose data end outside", Chunk("", 4, 0, 1ull << 40, "data")},
      {"a plain chunk of another size", Chunk("", 5, 0, 4, "data")},
      {"zstd of more than it says", Chunk("zstd", 1000, 0, bomb.size(), bomb)},
      {"zstd of less than it says", Chunk("zstd", 1 << 21, 0, bomb.size(), bomb)},
      {"zstd that is none", Chunk("zstd", 4, 0, 4, "data")},
      {"lz4 that is none", Chunk("lz4", 4, 0, 4, "data")},
      {"lz4 of nothing", Chunk("lz4", 4, 0, 0, "")},
      {"an unknown compression", Chunk("rar", 4, 0, 4, "data")},
      {"a wrong CRC", Chunk("", 4, 7, 4, "data")},
      {"a record in a chunk that leaves it",
       Chunk("", 9, 0, 9, std::string("\x05\x01\0\0\0\0\0\0\0", 9))},
      {"a chunk in a chunk", Chunk("", Chunk("", 0, 0, 0, "").size(), 0,
                                   Chunk("", 0, 0, 0, "").size(), Chunk("", 0, 0, 0, ""))},
      {"a message on an unknown channel", MessageRecord(2, 9, "d")},
      {"a message without its fields", Record(0x05, "short")},
      {"a time beyond int64", MessageRecord(1, 1ull << 63, "d")},
      {"a channel with an unknown schema", Channel(2, 2, "/u")},
      {"another schema under the same number", Schema(1, "other")},
      {"another channel under the same number", Channel(1, 1, "/other")},
      {"a footer of another size", Record(0x02, std::string(19, '\0'))},
      {"a second header", Record(0x01, std::string(8, '\0'))},
      {"a message outside of the chunks", Chunk("", 0, 0, 0, "") + MessageRecord(1, 9, "d")},
      {"a kind of 0", Record(0x00, "")},
      {"an index of nothing", Record(0x07, "")},
  };
  for (const auto& [what, bytes] : cases) {
    const Delivered delivered = ReadBytes(good + bytes + End());
    EXPECT_EQ(delivered.status.code(), absl::StatusCode::kDataLoss) << what;
    EXPECT_THAT(std::string(delivered.status.message()), HasSubstr("damaged at byte ")) << what;
    EXPECT_EQ(delivered.messages.size(), 1u) << what;
  }
}

TEST(Damage, LimitsHold) {
  const std::string head = Head() + Schema(1, "s") + Channel(1, 1, "/t");
  const std::string message = MessageRecord(1, 9, std::string(1000, 'x'));
  const std::string chunk = Chunk("", message.size(), 0, message.size(), message);
  const ReaderLimits roomy{.max_record_bytes = 1022, .max_chunk_uncompressed_bytes = 1031};
  EXPECT_TRUE(ReadBytes(head + message + chunk + End(), roomy).status.ok());
  const ReaderLimits tight_record{.max_record_bytes = 999, .max_chunk_uncompressed_bytes = 2000};
  EXPECT_EQ(ReadBytes(head + message + End(), tight_record).status.code(),
            absl::StatusCode::kDataLoss);
  EXPECT_EQ(ReadBytes(head + chunk + End(), tight_record).status.code(),
            absl::StatusCode::kDataLoss);
  const ReaderLimits tight_chunk{.max_record_bytes = 2000, .max_chunk_uncompressed_bytes = 1030};
  EXPECT_EQ(ReadBytes(head + chunk + End(), tight_chunk).status.code(),
            absl::StatusCode::kDataLoss);
}

TEST(Reader, SkipsWhatItDoesNotKnow) {
  const std::string inner = Record(0x10, "later") + Record(0x80, "private") + Schema(1, "s") +
                            Channel(1, 1, "/t") + MessageRecord(1, 9, "d");
  const std::string last = MessageRecord(1, 10, "e");
  const std::string metadata = Record(0x0c, std::string(8, '\0'));
  const std::string bytes = Head() + Record(0x7f, "later") + metadata +
                            Chunk("", inner.size(), 0, inner.size(), inner) +
                            Record(0xff, std::string(100'000, 'p')) + Channel(1, 1, "/t") +
                            Schema(1, "s") + Chunk("", last.size(), 0, last.size(), last) + End();
  const Delivered delivered = ReadBytes(bytes);
  EXPECT_TRUE(delivered.status.ok()) << delivered.status;
  ASSERT_EQ(delivered.messages.size(), 2u);
  EXPECT_EQ(delivered.messages[1].data, "e");
}

// liblz4's own defaults differ from what other writers choose.
TEST(Reader, ReadsEveryKindOfLz4Frame) {
  const std::string message = MessageRecord(1, 9, std::string(200'000, 'd') + "end");
  const std::string records = Schema(1, "s") + Channel(1, 1, "/t") + message;
  LZ4F_preferences_t preferences = LZ4F_INIT_PREFERENCES;
  preferences.frameInfo.blockMode = LZ4F_blockLinked;
  preferences.frameInfo.blockSizeID = LZ4F_max64KB;
  preferences.frameInfo.contentChecksumFlag = LZ4F_contentChecksumEnabled;
  preferences.frameInfo.blockChecksumFlag = LZ4F_blockChecksumEnabled;
  std::string frames;
  for (const std::string_view part :
       {std::string_view(records).substr(0, 150'000), std::string_view(records).substr(150'000)}) {
    std::string frame(LZ4F_compressFrameBound(part.size(), &preferences), '\0');
    frame.resize(
        LZ4F_compressFrame(frame.data(), frame.size(), part.data(), part.size(), &preferences));
    frames += frame;
  }
  const auto read = [&](const std::string& data) {
    return ReadBytes(Head() + Chunk("lz4", records.size(), 0, data.size(), data) + End());
  };
  EXPECT_TRUE(read(frames).status.ok()) << read(frames).status;
  ASSERT_EQ(read(frames).messages.size(), 1u);
  EXPECT_EQ(read(frames).messages[0].data.substr(200'000), "end");
  EXPECT_FALSE(read(frames.substr(0, frames.size() - 1)).status.ok());
  EXPECT_FALSE(read(frames + frames).status.ok());
}

TEST(Reader, ChecksAttachments) {
  std::string content;
  AppendU64(content, 1);
  AppendU64(content, 2);
  AppendString(content, "name");
  AppendString(content, "text/plain");
  AppendU64(content, 100'000);
  content += std::string(100'000, 'a');
  for (const std::uint32_t error : {0u, 1u}) {
    std::string attachment = content;
    AppendU32(attachment, ExtendCrc32(0, content) ^ error);
    const Delivered delivered = ReadBytes(Head() + Record(0x09, attachment) + End());
    EXPECT_EQ(delivered.status.ok(), error == 0) << delivered.status;
  }
}

TEST(Reader, RefusesOtherFiles) {
  const auto status = [](const std::string& bytes) { return ReadBytes(bytes).status; };
  EXPECT_EQ(status("").code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(status("#ROSBAG V2.0\n and more").code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status("\x89MCAP1\r\n and more").message()), HasSubstr("version"));
  EXPECT_EQ(ReadAll(FreshPath("none")).status.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(ReadAll(testing::TempDir()).status.code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace soundmap::recording
