#include "pipeline/operations.h"

#include <gtest/gtest.h>

#include <boost/asio/thread_pool.hpp>
#include <future>

namespace soundmap::pipeline {
namespace {

class OperationsTest : public ::testing::Test {
 protected:
  OperationInfo Done(const std::string& id) {
    std::promise<OperationInfo> done;
    EXPECT_TRUE(operations_
                    .Wait(id, absl::Seconds(60),
                          [&done](const OperationInfo& info) { done.set_value(info); })
                    .ok());
    return done.get_future().get();
  }

  boost::asio::thread_pool timers_{1};
  Operations operations_{[] { return std::int64_t{42}; }, timers_.get_executor()};
};

TEST_F(OperationsTest, ReportsProgressAndItsEnd) {
  std::promise<void> reported;
  std::promise<void> go_on;
  const auto started = operations_.Start("build_map", "hall", "", [&](OperationContext& context) {
    context.Report(0.5, "half");
    reported.set_value();
    go_on.get_future().wait();
    return absl::StatusOr<std::string>("{}");
  });
  ASSERT_TRUE(started.ok());
  reported.get_future().wait();
  EXPECT_EQ(operations_.Get(started->id)->progress_text, "half");
  EXPECT_FALSE(operations_.Get(started->id)->done);
  go_on.set_value();
  const OperationInfo done = Done(started->id);
  EXPECT_TRUE(done.done);
  EXPECT_TRUE(done.status.ok());
  EXPECT_EQ(done.progress, 1.0);
  EXPECT_EQ(done.report_json, "{}");
}

TEST_F(OperationsTest, WaitingEndsWithTheTimeToo) {
  std::promise<void> go_on;
  const auto started = operations_.Start("build_map", "hall", "", [&](OperationContext&) {
    go_on.get_future().wait();
    return absl::StatusOr<std::string>("{}");
  });
  std::promise<bool> done;
  ASSERT_TRUE(operations_
                  .Wait(started->id, absl::ZeroDuration(),
                        [&done](const OperationInfo& info) { done.set_value(info.done); })
                  .ok());
  EXPECT_FALSE(done.get_future().get());
  go_on.set_value();
  EXPECT_TRUE(Done(started->id).done);
}

TEST_F(OperationsTest, IsCancelled) {
  std::promise<void> running;
  const auto started = operations_.Start("build_map", "hall", "", [&](OperationContext& context) {
    running.set_value();
    while (!context.cancelled()) std::this_thread::yield();
    return absl::StatusOr<std::string>(absl::CancelledError("cancelled"));
  });
  running.get_future().wait();
  ASSERT_TRUE(operations_.Cancel(started->id).ok());
  EXPECT_TRUE(absl::IsCancelled(Done(started->id).status));
  EXPECT_TRUE(absl::IsNotFound(operations_.Cancel("99").status()));
}

TEST_F(OperationsTest, TheSameRequestStartsOnce) {
  int runs = 0;
  const auto work = [&runs](OperationContext&) {
    ++runs;
    return absl::StatusOr<std::string>("{}");
  };
  const auto first = operations_.Start("import_map", "hall", "request", work);
  const auto second = operations_.Start("import_map", "hall", "request", work);
  EXPECT_EQ(first->id, second->id);
  Done(first->id);
  EXPECT_EQ(runs, 1);
  EXPECT_EQ(operations_.List("hall").size(), 1u);
  EXPECT_TRUE(operations_.List("other").empty());
}

}  // namespace
}  // namespace soundmap::pipeline
