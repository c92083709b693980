#include "storage/group_commit.h"

#include <gtest/gtest.h>

#include <boost/asio/thread_pool.hpp>
#include <condition_variable>
#include <filesystem>
#include <map>
#include <mutex>

#include "storage/frame_sequence.h"

namespace soundmap::storage {
namespace {

// Takes the calls and lets a test wait for what they say.
class Durable {
 public:
  void operator()(const SessionId& id, const absl::StatusOr<std::int64_t>& durable) {
    const std::lock_guard lock(mutex_);
    if (durable.ok()) {
      EXPECT_GT(*durable, counts_[id]);
      counts_[id] = *durable;
    } else {
      errors_.push_back(durable.status());
    }
    changed_.notify_all();
  }
  void WaitFor(const SessionId& id, std::int64_t count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return counts_[id] == count; });
  }
  void WaitForErrors(std::size_t count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return errors_.size() >= count; });
  }
  std::vector<absl::Status> errors() {
    const std::lock_guard lock(mutex_);
    return errors_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::map<SessionId, std::int64_t> counts_;
  std::vector<absl::Status> errors_;
};

class GroupCommitTest : public ::testing::TestWithParam<int> {
 protected:
  const std::string folder_ = EmptyFolder("group_commit");
  std::unique_ptr<Store> store_ = Store::Open(folder_).value();
  boost::asio::thread_pool pool_{static_cast<std::size_t>(GetParam())};
  Durable durable_;

  GroupCommit::OnDurable Callback() {
    return [this](const SessionId& id, const absl::StatusOr<std::int64_t>& durable) {
      durable_(id, durable);
    };
  }
};

TEST_P(GroupCommitTest, MakesTheFramesOfAllSessionsDurable) {
  GroupCommit group_commit(pool_.get_executor(), store_.get(), Callback(),
                           {std::chrono::milliseconds(2), 64});
  for (int round = 1; round <= 20; ++round) {
    for (const char* const session : {"a", "b", "c"}) {
      auto log = store_->OpenSession({"hall", session}).value();
      while (log->received() < 10 * round) {
        ASSERT_TRUE(log->Append(FrameAt(log->received())).ok());
      }
    }
    for (const char* const session : {"a", "b", "c"}) {
      durable_.WaitFor({"hall", session}, 10 * round);
      EXPECT_EQ(store_->OpenSession({"hall", session}).value()->durable(), 10 * round);
    }
  }
  group_commit.Stop();
  auto log = store_->OpenSession({"hall", "a"}).value();
  ASSERT_TRUE(log->Append(FrameAt(log->received())).ok());
  pool_.join();  // returns: nothing is scheduled any more
  EXPECT_EQ(log->durable(), 200);
  EXPECT_TRUE(durable_.errors().empty());
}

TEST_P(GroupCommitTest, TriesAgainAfterErrors) {
  auto log = store_->OpenSession({"hall", "a"}).value();
  const std::string folder = folder_ + "/sessions/hall/a";
  std::filesystem::remove(folder);
  WriteWholeFile(folder, "in the way");
  ASSERT_TRUE(log->Append(FrameAt(0)).ok());
  GroupCommit group_commit(pool_.get_executor(), store_.get(), Callback(),
                           {std::chrono::milliseconds(1), 4});
  auto other = store_->OpenSession({"hall", "b"}).value();
  ASSERT_TRUE(other->Append(FrameAt(0)).ok());
  durable_.WaitFor({"hall", "b"}, 1);  // one log's trouble is not another's
  durable_.WaitForErrors(3);
  EXPECT_FALSE(log->Append(FrameAt(1)).ok());
  EXPECT_EQ(log->durable(), 0);
  std::filesystem::remove(folder);
  std::filesystem::create_directory(folder);
  durable_.WaitFor({"hall", "a"}, 1);
  EXPECT_EQ(log->Append(FrameAt(1)).value(), 1);
  durable_.WaitFor({"hall", "a"}, 2);
}

INSTANTIATE_TEST_SUITE_P(Threads, GroupCommitTest, ::testing::Values(1, 3));

}  // namespace
}  // namespace soundmap::storage
