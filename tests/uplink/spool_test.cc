#include "spool/spool.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <thread>

#include "tests/uplink/spooled_frames.h"

namespace soundmap::spool {
namespace {

using ::testing::HasSubstr;

class SpoolTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) /
              ::testing::UnitTest::GetInstance()->current_test_info()->name();
    std::filesystem::remove_all(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  static void Record(Spool& spool, std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) ASSERT_TRUE(spool.Append(FrameAt(i)).ok());
  }
  // Waits for a frame that must come.
  static sources::SensorFrame Await(sources::FrameSource& source) {
    while (true) {
      auto frame = source.Next();
      EXPECT_TRUE(frame.ok()) << frame.status();
      if (!frame.ok() || *frame) return frame.ok() ? **std::move(frame) : sources::SensorFrame{};
      std::this_thread::yield();
    }
  }
  std::vector<std::filesystem::path> SegmentsOf(const std::string& session) const {
    std::vector<std::filesystem::path> paths;
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / session)) {
      if (entry.path().extension() == ".mcap") paths.push_back(entry.path());
    }
    std::sort(paths.begin(), paths.end());
    return paths;
  }

  std::filesystem::path folder_;
};

TEST_F(SpoolTest, GivesBackWhatWasRecordedOverRestarts) {
  std::int64_t next = 0;
  for (int run = 0; run < 4; ++run) {
    const auto spool = Reopen(folder_, SmallSegments());
    const auto begun = spool->Begin(RequestFor("d"));
    ASSERT_TRUE(begun.ok()) << begun.status();
    EXPECT_EQ(begun->position, next);
    EXPECT_FALSE(begun->ended);
    Record(*spool, next, next + 50 * run + 1);
    next += 50 * run + 1;
    if (run == 3) {
      ASSERT_TRUE(spool->End().ok());
    }
  }
  const auto spool = Reopen(folder_, SmallSegments());
  EXPECT_THAT(spool->Waiting(), ::testing::ElementsAre("d"));
  EXPECT_EQ(spool->RequestOf("d")->SerializeAsString(), RequestFor("d").SerializeAsString());
  const auto source = spool->Read("d");
  for (const std::int64_t from : {0l, 3l, 100l, static_cast<long>(next)}) {
    ASSERT_TRUE(source->Seek(from).ok());
    for (std::int64_t i = from; i < next; ++i) {
      const auto frame = source->Next();
      ASSERT_TRUE(frame.ok() && *frame) << i;
      ASSERT_TRUE(Same(**frame, FrameAt(i))) << i;
    }
    EXPECT_FALSE(source->Next()->has_value());
    EXPECT_TRUE(source->AtEnd());
  }
  EXPECT_FALSE(source->Seek(next + 1).ok());

  ASSERT_TRUE(spool->SetDelivered("d").ok());
  EXPECT_TRUE(spool->Waiting().empty());
  EXPECT_TRUE(SegmentsOf("d").empty());
  EXPECT_TRUE(spool->Begin(RequestFor("d"))->ended);
}

TEST_F(SpoolTest, DeliversNothingThatIsNotOnTheDisk) {
  SpoolOptions options = SmallSegments();
  options.sync_bytes = 1 << 30;
  options.sync_interval = std::chrono::hours(10);
  const auto spool = Reopen(folder_, options);
  ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
  Record(*spool, 0, 20);
  const auto source = spool->Read("d");
  ASSERT_TRUE(source->Seek(0).ok());
  EXPECT_FALSE(source->Next()->has_value());
  EXPECT_FALSE(source->AtEnd());
  ASSERT_TRUE(spool->End().ok());
  for (int i = 0; i < 20; ++i) EXPECT_TRUE(Same(**source->Next(), FrameAt(i)));
  EXPECT_TRUE(source->AtEnd());
}

TEST_F(SpoolTest, FreesWhatIsDurableAtTheServer) {
  const auto spool = Reopen(folder_, SmallSegments());
  ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
  Record(*spool, 0, 300);
  ASSERT_TRUE(spool->End().ok());
  const std::size_t before = SegmentsOf("d").size();
  ASSERT_GT(before, 10u);
  spool->Free("d", 150);
  const auto left = SegmentsOf("d");
  EXPECT_LT(left.size(), before);
  // The one with frame 150 begins there or before.
  EXPECT_LE(std::stoll(left.front().stem()), 150);
  EXPECT_GT(std::stoll(left[1].stem()), 150);
  const auto source = spool->Read("d");
  ASSERT_TRUE(source->Seek(150).ok());
  for (int i = 150; i < 300; ++i) ASSERT_TRUE(Same(**source->Next(), FrameAt(i)));
  spool->Free("d", 300);
  EXPECT_EQ(SegmentsOf("d").size(), 1u);
}

TEST_F(SpoolTest, PausesWhenFullIfAskedTo) {
  SpoolOptions options = SmallSegments();
  options.max_bytes = 20'000;
  options.pause_when_full = true;
  const auto spool = Reopen(folder_, options);
  ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
  std::thread recorder([&] {
    Record(*spool, 0, 500);
    EXPECT_TRUE(spool->End().ok());
  });
  const auto source = spool->Read("d");
  ASSERT_TRUE(source->Seek(0).ok());
  for (int i = 0; i < 500; ++i) {
    ASSERT_TRUE(Same(Await(*source), FrameAt(i))) << i;
    std::uintmax_t bytes = 0;
    for (const auto& path : SegmentsOf("d")) bytes += std::filesystem::file_size(path);
    EXPECT_LE(bytes, 30'000u);  // the records of a segment's end count too
    spool->Free("d", i + 1);
  }
  recorder.join();
  EXPECT_TRUE(Inspect(folder_.string())->front().gaps.empty());
}

TEST_F(SpoolTest, StopsWhileItWaitsForRoom) {
  SpoolOptions options = SmallSegments();
  options.max_bytes = 20'000;
  options.pause_when_full = true;
  const auto spool = Reopen(folder_, options);
  ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
  absl::Status status;
  std::thread recorder([&] {
    for (int i = 0; status.ok(); ++i) status = spool->Append(FrameAt(i));
  });
  const auto source = spool->Read("d");
  ASSERT_TRUE(source->Seek(0).ok());
  for (int i = 0; i < 30; ++i) Await(*source);
  spool->Stop();
  recorder.join();
  EXPECT_TRUE(absl::IsCancelled(status));
}

TEST_F(SpoolTest, TheOldestGoWhenItIsFullAndTheGapIsRecorded) {
  SpoolOptions options = SmallSegments();
  options.max_bytes = 20'000;
  std::int64_t lost = 0;
  std::string record;
  for (int run = 0; run < 2; ++run) {
    const auto spool = Reopen(folder_, options);
    ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
    if (run == 0) {
      Record(*spool, 0, 1000);
      ASSERT_TRUE(spool->End().ok());
    }
    const auto source = spool->Read("d");
    ASSERT_TRUE(source->Seek(0).ok());
    const auto gap = source->Next();
    ASSERT_TRUE(gap.ok() && *gap);
    EXPECT_EQ((*gap)->sensor, sources::Sensor::kGap);
    std::string reason;
    lost = LostBy(**gap, &reason);
    EXPECT_GT(lost, 800);
    EXPECT_EQ(reason, "the spool was full");
    EXPECT_EQ((*gap)->log_time_ns, FrameAt(lost).log_time_ns);
    if (run == 1) {
      EXPECT_EQ((*gap)->payload, record);  // the same, however often it is sent
    }
    record = (*gap)->payload;
    for (std::int64_t i = lost; i < 1000; ++i) ASSERT_TRUE(Same(**source->Next(), FrameAt(i)));
    EXPECT_TRUE(source->AtEnd());
  }
  const auto summary = Inspect(folder_.string());
  ASSERT_TRUE(summary.ok()) << summary.status();
  ASSERT_EQ(summary->size(), 1u);
  EXPECT_EQ(summary->front().recorded, 1000);
  EXPECT_EQ(summary->front().waiting, 1000 - lost);
  ASSERT_EQ(summary->front().gaps.size(), 1u);
  EXPECT_EQ(summary->front().gaps[0].end, lost);
}

TEST_F(SpoolTest, ADamagedSegmentIsAGapAndADamagedSessionIsLeftAlone) {
  {
    const auto spool = Reopen(folder_, SmallSegments());
    ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
    Record(*spool, 0, 200);
    ASSERT_TRUE(spool->End().ok());
    ASSERT_TRUE(spool->Begin(RequestFor("e")).ok());
    Record(*spool, 0, 10);
  }
  const auto segments = SegmentsOf("d");
  {
    std::fstream file(segments[2], std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(static_cast<std::streamoff>(std::filesystem::file_size(segments[2]) / 3));
    file.put('\x55');
    file.put('\x66');
  }
  std::ofstream(folder_ / "e" / "session.json") << "{\"format\": 1, ";
  const auto spool = Reopen(folder_, SmallSegments());
  ASSERT_EQ(spool->warnings().size(), 1u);
  EXPECT_THAT(spool->warnings()[0], HasSubstr("session.json is damaged"));
  EXPECT_THAT(spool->Waiting(), ::testing::ElementsAre("d"));
  const auto source = spool->Read("d");
  ASSERT_TRUE(source->Seek(0).ok());
  std::int64_t position = 0;
  int gaps = 0;
  while (position < 200) {
    const auto frame = source->Next();
    ASSERT_TRUE(frame.ok() && *frame) << position;
    if ((*frame)->sensor == sources::Sensor::kGap) {
      std::string reason;
      position += LostBy(**frame, &reason);
      EXPECT_EQ(reason, "the spool is damaged");
      EXPECT_EQ(position, std::stoll(segments[3].stem()));
      ++gaps;
    } else {
      ASSERT_TRUE(Same(**frame, FrameAt(position++)));
    }
  }
  EXPECT_EQ(gaps, 1);
}

TEST_F(SpoolTest, ARecordWhoseNumbersDoNotFitTogetherIsDamaged) {
  SessionRecord record;
  record.request = RequestFor("d");
  record.next = 20;
  // Frames 3 to 7, and 10 to 19: the server gets one record for each.
  record.gaps = {{3, 3, 8, 1, 2, "full"}, {6, 10, 20, 3, 4, "full"}};
  std::filesystem::create_directories(folder_ / "d");
  const auto read = [&](const SessionRecord& changed) {
    EXPECT_TRUE(WriteRecord((folder_ / "d").string(), changed).ok());
    return ReadRecord((folder_ / "d").string()).status().code();
  };
  EXPECT_EQ(read(record), absl::StatusCode::kOk);
  for (const std::int64_t next : {std::int64_t{-1}, std::int64_t{1} << 62}) {
    SessionRecord changed = record;
    changed.next = next;
    EXPECT_EQ(read(changed), absl::StatusCode::kDataLoss) << next;
  }
  for (std::int64_t Gap::*number : {&Gap::offset, &Gap::first, &Gap::end}) {
    for (std::size_t gap : {0, 1}) {
      for (const int change : {-30, -1, 1, 30}) {
        SessionRecord changed = record;
        changed.gaps[gap].*number += change;
        // A gap may end elsewhere if none follows it.
        const bool fits = number == &Gap::end && gap == 1 && change == -1;
        EXPECT_EQ(read(changed), fits ? absl::StatusCode::kOk : absl::StatusCode::kDataLoss)
            << gap << " " << change;
      }
    }
  }
}

TEST_F(SpoolTest, ARecordWhoseNumbersAreNoIntegersIsDamaged) {
  SessionRecord record;
  record.request = RequestFor("d");
  record.next = 20;
  std::filesystem::create_directories(folder_ / "d");
  const std::string file = (folder_ / "d" / "session.json").string();
  ASSERT_TRUE(WriteRecord((folder_ / "d").string(), record).ok());
  std::ifstream in(file);
  const std::string stored{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  const std::string next = "\"next\": 20";
  ASSERT_NE(stored.find(next), std::string::npos);
  for (const char* number : {"20.5", "1e25", "18446744073709551615", "true"}) {
    std::string damaged = stored;
    damaged.replace(stored.find(next), next.size(), absl::StrCat("\"next\": ", number));
    std::ofstream(file) << damaged;
    EXPECT_EQ(ReadRecord((folder_ / "d").string()).status().code(), absl::StatusCode::kDataLoss)
        << number;
  }
}

TEST_F(SpoolTest, OneAgentAtATime) {
  const auto spool = Reopen(folder_, SmallSegments());
  const auto other = Spool::Open(folder_.string(), SmallSegments(), [] { return 1; });
  EXPECT_EQ(other.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_FALSE(spool->Begin(RequestFor("../up")).ok());
  EXPECT_FALSE(spool->Append(FrameAt(0)).ok());
  EXPECT_EQ(Inspect((folder_ / "nowhere").string()).status().code(), absl::StatusCode::kNotFound);
}

// Any order of recording, delivering, crashes of the server (which keeps what is durable), restarts
// of the agent and a spool that is too small: in the end the server has every frame once and in
// order, or a record of how many are missing.
TEST_F(SpoolTest, WhateverHappensEachFrameArrivesOnceOrIsCountedAsLost) {
  for (unsigned seed = 1; seed <= 12; ++seed) {
    SCOPED_TRACE(seed);
    std::filesystem::remove_all(folder_);
    std::mt19937 random(seed);
    SpoolOptions options = SmallSegments();
    if (seed % 4 != 0) options.max_bytes = 16'000 + 4'000 * (random() % 4);
    auto spool = Reopen(folder_, options);
    ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
    auto source = spool->Read("d");
    std::int64_t recorded = 0;
    std::vector<sources::SensorFrame> server;
    std::size_t durable = 0;
    const auto receive = [&](int count) {
      for (int i = 0; i < count; ++i) {
        auto frame = source->Next();
        ASSERT_TRUE(frame.ok()) << frame.status();
        if (!*frame) return;
        server.push_back(**std::move(frame));
      }
    };
    for (int step = 0; step < 60; ++step) {
      switch (random() % 6) {
        case 0:
        case 1: {
          const std::int64_t more = random() % 40;
          Record(*spool, recorded, recorded + more);
          recorded += more;
          break;
        }
        case 2:
        case 3:
          receive(static_cast<int>(random() % 30));
          break;
        case 4:
          durable += random() % (server.size() - durable + 1);
          spool->Free("d", static_cast<std::int64_t>(durable));
          break;
        case 5:
          if (random() % 2 == 0) {
            source.reset();
            spool.reset();
            spool = Reopen(folder_, options);
            ASSERT_EQ(spool->Begin(RequestFor("d"))->position, recorded);
            source = spool->Read("d");
          }
          server.resize(durable + random() % (server.size() - durable + 1));
          ASSERT_TRUE(source->Seek(static_cast<std::int64_t>(server.size())).ok());
          break;
      }
    }
    ASSERT_TRUE(spool->End().ok());
    ASSERT_TRUE(source->Seek(static_cast<std::int64_t>(server.size())).ok());
    receive(100'000);
    EXPECT_TRUE(source->AtEnd());
    std::int64_t position = 0;
    for (const sources::SensorFrame& frame : server) {
      if (frame.sensor == sources::Sensor::kGap) {
        ASSERT_GT(LostBy(frame), 0);
        position += LostBy(frame);
      } else {
        ASSERT_TRUE(Same(frame, FrameAt(position))) << position;
        ++position;
      }
    }
    EXPECT_EQ(position, recorded);
    if (seed % 4 == 0) {
      EXPECT_EQ(static_cast<std::int64_t>(server.size()), recorded);
    }
  }
}

}  // namespace
}  // namespace soundmap::spool
