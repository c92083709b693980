#include "storage/session_log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <iterator>
#include <map>
#include <random>
#include <vector>

#include "recording/reader.h"
#include "storage/crc32c.h"
#include "storage/frame_sequence.h"

namespace soundmap::storage {
namespace {

using ::testing::HasSubstr;

// CRC-32C bit by bit, from its polynomial.
std::uint32_t SlowCrc32c(const std::string& bytes) {
  std::uint32_t remainder = 0xffffffffu;
  for (const char byte : bytes) {
    remainder ^= static_cast<unsigned char>(byte);
    for (int bit = 0; bit < 8; ++bit) {
      remainder = (remainder >> 1) ^ ((remainder & 1) != 0 ? 0x82f63b78u : 0);
    }
  }
  return ~remainder;
}

void AppendFrames(SessionLog* log, std::int64_t end) {
  for (std::int64_t offset = log->received(); offset < end; ++offset) {
    const auto appended = log->Append(FrameAt(offset));
    ASSERT_TRUE(appended.ok()) << appended.status();
    ASSERT_EQ(*appended, offset);
  }
}

// Reads all from `first_offset` and checks each frame against what was sent; returns how many there
// were.
std::int64_t CountRightFrames(const SessionLog& log, std::int64_t first_offset,
                              absl::Status* end = nullptr) {
  auto reader = log.Read(first_offset);
  EXPECT_TRUE(reader.ok()) << reader.status();
  std::int64_t offset = first_offset;
  while (true) {
    EXPECT_EQ((*reader)->next_offset(), offset);
    const auto frame = (*reader)->Next();
    if (end != nullptr) *end = frame.status();
    EXPECT_TRUE(frame.ok() || end != nullptr) << frame.status();
    if (!frame.ok() || !frame->has_value()) return offset - first_offset;
    const recording::Message sent = FrameAt(offset);
    EXPECT_EQ((*frame)->topic, sent.topic);
    EXPECT_EQ((*frame)->schema, sent.schema);
    EXPECT_EQ((*frame)->log_time_ns, sent.log_time_ns);
    EXPECT_EQ((*frame)->data, sent.data) << offset;
    ++offset;
  }
}

TEST(Crc32c, EqualsTheDefinitionAndAddsUp) {
  EXPECT_EQ(Crc32c("123456789"), 0xe3069283u);  // RFC 3720's check value
  const std::string bytes = FrameAt(4).data + FrameAt(5).data;
  EXPECT_EQ(Crc32c(bytes), SlowCrc32c(bytes));
  EXPECT_EQ(Crc32c(bytes.substr(100), Crc32c(bytes.substr(0, 100))), Crc32c(bytes));
}

TEST(SessionLog, FramesComeBackInOrderAcrossSegmentsAndReopening) {
  const std::string folder = EmptyFolder("order");
  SessionLogOptions options;
  options.segment_bytes = 5000;
  std::mt19937 random(1);
  std::int64_t frames = 0;
  for (int session = 0; session < 8; ++session) {
    auto log = SessionLog::Open(folder, options);
    ASSERT_TRUE(log.ok()) << log.status();
    EXPECT_EQ((*log)->received(), frames);
    EXPECT_EQ((*log)->durable(), frames);
    for (int group = 0; group < 10; ++group) {
      const std::int64_t before = (*log)->durable();
      frames += static_cast<std::int64_t>(random() % 20);
      AppendFrames(log->get(), frames);
      EXPECT_EQ((*log)->received(), frames);
      EXPECT_EQ((*log)->durable(), before);
      EXPECT_EQ(CountRightFrames(**log, 0), before);  // nothing that is not durable
      ASSERT_EQ((*log)->Sync().value(), frames);
    }
    const auto first = static_cast<std::int64_t>(random() % static_cast<unsigned>(frames + 1));
    EXPECT_EQ(CountRightFrames(**log, first), frames - first);
    if (session % 2 == 0) {
      ASSERT_TRUE((*log)->Close().ok());
    }
  }
  EXPECT_GT(FilesUnder(folder, ".mcap").size(), 10u);
}

TEST(SessionLog, AReaderThatIsExtendedGoesOnWhereItStands) {
  std::mt19937 random(2);
  for (int round = 0; round < 20; ++round) {
    const std::string folder = EmptyFolder("extended");
    SessionLogOptions options;
    options.segment_bytes = 1 + static_cast<std::int64_t>(random() % 20'000);
    auto log = SessionLog::Open(folder, options).value();
    AppendFrames(log.get(), static_cast<std::int64_t>(random() % 30));
    ASSERT_TRUE(log->Sync().ok());
    std::int64_t next = round == 0 ? 0 : log->durable() / 2;
    const auto reader = log->Read(next).value();
    std::int64_t end = log->durable();
    for (int group = 0; group < 30; ++group) {
      const std::int64_t stop = std::min(end, next + static_cast<std::int64_t>(random() % 20));
      for (; next < stop; ++next) {
        ASSERT_EQ(reader->next_offset(), next);
        const auto frame = reader->Next();
        ASSERT_TRUE(frame.ok() && frame->has_value()) << next << " " << frame.status();
        ASSERT_EQ((*frame)->data, FrameAt(next).data);
      }
      if (next == end) {
        ASSERT_FALSE(reader->Next().value().has_value()) << "nothing that it was not extended by";
      }
      AppendFrames(log.get(), log->received() + static_cast<std::int64_t>(random() % 15));
      if (random() % 4 == 0) {
        ASSERT_TRUE(log->Extend(*reader).ok());  // by what is durable, and no more
        end = log->durable();
      }
      ASSERT_TRUE(log->Sync().ok());
      if (random() % 2 == 0) {
        ASSERT_TRUE(log->Extend(*reader).ok());
        end = log->durable();
      }
    }
  }
}

TEST(SessionLog, SegmentsAreRecordingsNamedByTheirFirstOffset) {
  const std::string folder = EmptyFolder("segments");
  SessionLogOptions options;
  options.segment_bytes = 2000;
  auto log = SessionLog::Open(folder, options).value();
  for (int group = 1; group <= 5; ++group) {
    AppendFrames(log.get(), 25 * group);
    ASSERT_TRUE(log->Sync().ok());
  }
  ASSERT_TRUE(log->Close().ok());
  std::int64_t offset = 0;
  for (const std::string& path : FilesUnder(folder, ".mcap")) {
    EXPECT_EQ(std::filesystem::path(path).stem().string().size(), 20u);
    EXPECT_EQ(std::stoll(std::filesystem::path(path).stem().string()), offset);
    auto reader = recording::Reader::Open(path).value();
    while (true) {
      const auto message = reader->Next();
      ASSERT_TRUE(message.ok()) << message.status();  // closed with footer and summary
      if (!message->has_value()) break;
      EXPECT_EQ((*message)->sequence, static_cast<std::uint32_t>(offset));
      EXPECT_EQ((*message)->data, FrameAt(offset).data);
      ++offset;
    }
  }
  EXPECT_EQ(offset, 125);
  EXPECT_TRUE(absl::IsFailedPrecondition(log->Append(FrameAt(125)).status()));
  EXPECT_EQ(CountRightFrames(*log, 0), 125);
}

TEST(SessionLog, ATornTailLeavesAPrefixThatGoesOn) {
  const std::string folder = EmptyMemoryFolder("torn");
  SessionLogOptions options;
  options.min_free_bytes = 0;
  std::map<std::size_t, std::int64_t> durable_at_size = {{0, 0}};
  std::string whole;
  {
    auto log = SessionLog::Open(folder, options).value();
    for (const std::int64_t end : {2, 3, 7}) {
      AppendFrames(log.get(), end);
      ASSERT_TRUE(log->Sync().ok());
      whole = ReadWholeFile(FilesUnder(folder, ".mcap").at(0));
      durable_at_size[whole.size()] = end;
    }
  }
  ASSERT_GT(whole.size(), 200u);
  std::int64_t last = 0;
  for (std::size_t cut = 0; cut <= whole.size(); ++cut) {
    const std::string torn = EmptyMemoryFolder("torn_at");
    WriteWholeFile(torn + "/00000000000000000000.mcap", whole.substr(0, cut));
    auto log = SessionLog::Open(torn, options);
    ASSERT_TRUE(log.ok()) << cut << ": " << log.status();
    const std::int64_t found = (*log)->durable();
    // Whole groups only: at least those that were synced within these bytes, never fewer for more
    // bytes.
    EXPECT_TRUE(found == 0 || found == 2 || found == 3 || found == 7) << cut << ": " << found;
    EXPECT_GE(found, std::prev(durable_at_size.upper_bound(cut))->second) << cut;
    EXPECT_GE(found, last) << cut;
    last = found;
    EXPECT_EQ(CountRightFrames(**log, 0), found);

    AppendFrames(log->get(), found + 3);
    ASSERT_TRUE((*log)->Sync().ok());
    log->reset();
    auto again = SessionLog::Open(torn, options, found + 3);
    ASSERT_TRUE(again.ok()) << cut << ": " << again.status();
    EXPECT_EQ((*again)->durable(), found + 3);
    EXPECT_EQ(CountRightFrames(**again, 0), found + 3);
  }
  EXPECT_EQ(last, 7);
}

TEST(SessionLog, FlippedBitsAreDataLossAndNeverOtherFrames) {
  const std::string folder = EmptyMemoryFolder("flips");
  SessionLogOptions options;
  options.min_free_bytes = 0;
  options.segment_bytes = 1500;
  {
    auto log = SessionLog::Open(folder, options).value();
    for (std::int64_t end = 4; end <= 40; end += 4) {
      AppendFrames(log.get(), end);
      ASSERT_TRUE(log->Sync().ok());
    }
  }
  const std::vector<std::string> paths = FilesUnder(folder, ".mcap");
  ASSERT_GE(paths.size(), 3u);
  int losses = 0;
  for (const std::string& path : {paths.front(), paths[1], paths.back()}) {
    const std::string whole = ReadWholeFile(path);
    for (std::size_t byte = 0; byte < whole.size(); byte += 3) {
      std::string flipped = whole;
      flipped[byte] = static_cast<char>(flipped[byte] ^ (1 << (byte / 3 % 8)));
      WriteWholeFile(path, flipped);
      const auto log = SessionLog::Open(folder, options, /*known_durable=*/40);
      absl::Status end = log.status();
      if (log.ok()) {
        ASSERT_EQ((*log)->durable(), 40);
        const std::int64_t right = CountRightFrames(**log, 0, &end);
        ASSERT_TRUE(right == 40 || !end.ok()) << path << " byte " << byte;
      }
      if (!end.ok()) {
        ++losses;
        EXPECT_TRUE(absl::IsDataLoss(end)) << path << " byte " << byte << ": " << end;
        EXPECT_THAT(std::string(end.message()), HasSubstr(path));
      }
    }
    WriteWholeFile(path, whole);
  }
  EXPECT_GT(losses, 500);
}

TEST(SessionLog, AMissingSegmentIsDataLoss) {
  const std::string folder = EmptyFolder("missing");
  SessionLogOptions options;
  options.segment_bytes = 1500;
  {
    auto log = SessionLog::Open(folder, options).value();
    for (std::int64_t end = 10; end <= 60; end += 10) {
      AppendFrames(log.get(), end);
      ASSERT_TRUE(log->Sync().ok());
    }
  }
  const std::vector<std::string> paths = FilesUnder(folder, ".mcap");
  ASSERT_GE(paths.size(), 3u);
  std::filesystem::rename(paths[1], paths[1] + ".away");
  absl::Status end;
  EXPECT_LT(CountRightFrames(*SessionLog::Open(folder, options, 60).value(), 0, &end), 60);
  EXPECT_TRUE(absl::IsDataLoss(end)) << end;
  std::filesystem::rename(paths[1] + ".away", paths[1]);

  std::filesystem::rename(paths[0], paths[0] + ".away");
  EXPECT_TRUE(absl::IsDataLoss(SessionLog::Open(folder, options).status()));
  std::filesystem::rename(paths[0] + ".away", paths[0]);

  std::filesystem::remove(paths.back());
  EXPECT_TRUE(absl::IsDataLoss(SessionLog::Open(folder, options, 60).status()));
}

TEST(SessionLog, KnowsThePayloadCrcsOfItsWindow) {
  const std::string folder = EmptyFolder("crcs");
  SessionLogOptions options;
  options.crc_window_frames = 8;
  auto log = SessionLog::Open(folder, options).value();
  AppendFrames(log.get(), 20);
  const auto check = [&log] {
    for (std::int64_t offset = -1; offset < 22; ++offset) {
      const auto crc = log->PayloadCrc(offset);
      ASSERT_EQ(crc.has_value(), offset >= 12 && offset < 20) << offset;
      if (crc) {
        EXPECT_EQ(*crc, SlowCrc32c(FrameAt(offset).data));
      }
    }
  };
  check();
  ASSERT_TRUE(log->Sync().ok());
  check();
  log.reset();
  log = SessionLog::Open(folder, options).value();
  check();
}

TEST(SessionLog, RefusesWhatItCouldNotWrite) {
  SessionLogOptions options;
  options.max_pending_bytes = 1000;
  auto log = SessionLog::Open(EmptyFolder("refuses"), options).value();
  const recording::Message good = FrameAt(0);

  recording::Message frame = good;
  frame.schema = "foxglove.Nothing";
  EXPECT_TRUE(absl::IsInvalidArgument(log->Append(frame).status()));
  frame = good;
  frame.topic = "";
  EXPECT_TRUE(absl::IsInvalidArgument(log->Append(frame).status()));
  frame = good;
  frame.log_time_ns = -1;
  EXPECT_TRUE(absl::IsInvalidArgument(log->Append(frame).status()));
  frame = good;
  frame.data.assign((32 << 20) + 1, 'x');
  EXPECT_TRUE(absl::IsInvalidArgument(log->Append(frame).status()));
  EXPECT_EQ(log->received(), 0);

  ASSERT_EQ(log->Append(good).value(), 0);
  frame = good;
  frame.schema = frame.schema == "foxglove.RawAudio" ? "foxglove.Odometry" : "foxglove.RawAudio";
  EXPECT_TRUE(absl::IsInvalidArgument(log->Append(frame).status()));  // a topic has one schema
  frame = good;
  frame.data.assign(1001, 'x');
  EXPECT_TRUE(absl::IsResourceExhausted(log->Append(frame).status()));
  ASSERT_EQ(log->Sync().value(), 1);
  EXPECT_EQ(log->Append(frame).value(), 1);  // alone it passes
  ASSERT_EQ(log->Sync().value(), 2);

  EXPECT_TRUE(absl::IsOutOfRange(log->Read(3).status()));
  EXPECT_TRUE(absl::IsOutOfRange(log->Read(-1).status()));
  EXPECT_EQ(CountRightFrames(*log, 2), 0);
}

}  // namespace
}  // namespace soundmap::storage
