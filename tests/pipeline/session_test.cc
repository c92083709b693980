#include "pipeline/session.h"

#include <gtest/gtest.h>

#include <atomic>
#include <boost/asio/post.hpp>
#include <boost/asio/thread_pool.hpp>
#include <filesystem>
#include <functional>
#include <future>
#include <optional>
#include <thread>

#include "pipeline/sites.h"

namespace soundmap::pipeline {
namespace {

constexpr std::size_t kFrameBytes = 50'000;

// Every frame is a gap, of which the session keeps a list: it tells what was processed, and in
// which order.
recording::Message FrameAt(std::int64_t offset) {
  recording::Message frame;
  frame.topic = "/session/gap";
  frame.schema = "foxglove.KeyValuePair";
  frame.log_time_ns = 1000 + offset;
  frame.data = std::string(kFrameBytes, static_cast<char>(offset));
  return frame;
}

// A mapping drive whose pipeline can be held up.
class BacklogTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) /
              ::testing::UnitTest::GetInstance()->current_test_info()->name();
    std::filesystem::remove_all(folder_);
    Open();
    ASSERT_TRUE(sites_->Create("hall", "", "").ok());
    ASSERT_TRUE(Hall()
                    .CreateSession({.session = "drive", .robot = "r", .purpose = Purpose::kMapping},
                                   /*now_ns=*/1)
                    .ok());
  }
  void TearDown() override {
    Close();
    std::filesystem::remove_all(folder_);
  }

  void Open() {
    store_ = storage::Store::Open(folder_.string()).value();
    Sites::Options options;
    options.executor = pool_.get_executor();
    options.sync_executor = log_pool_.get_executor();
    options.decode = [this](const recording::Message& message, const frames::Calibration&) {
      ++decoded_;
      Gap gap;
      gap.frames = message.log_time_ns;
      return absl::StatusOr<Session::Decoded>(gap);
    };
    options.profile = ProfileByName;
    options.now_ns = [] { return std::int64_t{1}; };
    meters_ = options.meters;
    sites_ = Sites::Open(store_.get(), std::move(options)).value();
  }
  void Close() {
    Release();
    sites_.reset();
    store_.reset();
  }

  // The pipeline's only thread does nothing else until Release().
  void Hold() {
    held_.emplace();
    std::promise<void> holds;
    boost::asio::post(pool_, [this, &holds, until = held_->get_future().share()] {
      holds.set_value();
      until.wait();
    });
    holds.get_future().wait();
  }
  void Release() {
    if (held_) held_->set_value();
    held_.reset();
  }

  Site& Hall() { return **sites_->Get("hall"); }
  Session& Drive() { return *Hall().GetSession("drive").value(); }
  void Receive(std::int64_t end) {
    for (std::int64_t offset = Drive().watermarks().received; offset < end; ++offset) {
      ASSERT_EQ(Drive().Receive(kEpoch, offset, FrameAt(offset)).value(), Session::Taken::kYes);
    }
  }
  void Await(const std::function<bool(const Watermarks&)>& is_so) {
    while (!is_so(Drive().watermarks())) {
      ASSERT_TRUE(Drive().fault().ok()) << Drive().fault();
      std::this_thread::yield();
    }
  }
  void AwaitDurable(std::int64_t frames) {
    Await([frames](const Watermarks& marks) { return marks.durable == frames; });
  }
  void ExpectEachOnceInOrder(std::int64_t frames) {
    const std::vector<Gap> gaps = Drive().record().gaps;
    ASSERT_EQ(static_cast<std::int64_t>(gaps.size()), frames);
    for (std::int64_t i = 0; i < frames; ++i) {
      const Gap& gap = gaps[static_cast<std::size_t>(i)];
      ASSERT_EQ(gap.offset, i);
      ASSERT_EQ(gap.frames, FrameAt(i).log_time_ns);
    }
  }

  static constexpr std::int64_t kEpoch = 1;
  std::filesystem::path folder_;
  boost::asio::thread_pool pool_{1};
  boost::asio::thread_pool log_pool_{1};
  std::optional<std::promise<void>> held_;
  std::atomic<std::int64_t> decoded_ = 0;
  std::shared_ptr<Meters> meters_;
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<Sites> sites_;
};

TEST_F(BacklogTest, WhatThePipelineCannotTakeWaitsOnTheDisk) {
  Drive().Attach(kEpoch, nullptr);
  Hold();
  constexpr std::int64_t kFirst = 300;
  Receive(kFirst);
  AwaitDurable(kFirst);
  EXPECT_EQ(Drive().watermarks().processed, 0);
  EXPECT_EQ(Drive().bytes_in_flight(), 0) << "the robot may send more";
  EXPECT_EQ(meters_->backlog_frames, kFirst);
  EXPECT_EQ(decoded_, kFirst);

  // It catches up while more comes, sometimes held up again.
  Release();
  std::int64_t sent = kFirst;
  for (const std::int64_t more : {1, 90, 20, 100, 3, 60, 200}) {
    if (more >= 90) Hold();
    Receive(sent += more);
    if (more == 200) AwaitDurable(sent);
    Release();
    if (more == 3) {
      Await([sent](const Watermarks& marks) { return marks.processed == sent; });
    }
  }
  ASSERT_TRUE(Drive().Finish(kEpoch, sent).ok());
  Await([](const Watermarks& marks) { return marks.complete; });
  ExpectEachOnceInOrder(sent);
  EXPECT_EQ(meters_->backlog_frames, 0);
  // 2 MiB of each of the two long waits were in memory; the rest was read from the log.
  EXPECT_GE(decoded_, sent + 300 + 200 - 2 * (2 << 20) / static_cast<std::int64_t>(kFrameBytes));
}

TEST_F(BacklogTest, ARestartGoesOnWithTheBacklogToTheEndOfTheDrive) {
  Drive().Attach(kEpoch, nullptr);
  Hold();
  constexpr std::int64_t kFrames = 500;
  Receive(kFrames);
  ASSERT_TRUE(Drive().Finish(kEpoch, kFrames).ok());
  AwaitDurable(kFrames);
  Close();
  const std::int64_t before = decoded_;
  Open();
  Await([](const Watermarks& marks) { return marks.complete; });
  ExpectEachOnceInOrder(kFrames);
  EXPECT_EQ(Drive().record().frame_count, kFrames);
  EXPECT_LE(decoded_ - before, kFrames) << "none is read twice";
  EXPECT_EQ(meters_->backlog_frames, 0);
}

}  // namespace
}  // namespace soundmap::pipeline
