#include "api/wake.h"

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>

namespace soundmap::api {
namespace {

TEST(Wake, RunsOnceForAllCallsUntilThen) {
  boost::asio::io_context context;
  int runs = 0;
  const Wake wake(context.get_executor(), std::chrono::milliseconds(0), [&runs] { ++runs; });
  const std::function<void()> copy = wake;
  for (int i = 0; i < 1000; ++i) i % 2 == 0 ? wake() : copy();
  EXPECT_EQ(runs, 0);
  EXPECT_EQ(context.run(), 1u);
  EXPECT_EQ(runs, 1);
  wake();
  context.restart();
  EXPECT_EQ(context.run(), 1u);
  EXPECT_EQ(runs, 2);
}

TEST(Wake, WhatIsCalledWhileItRunsRunsAgain) {
  boost::asio::io_context context;
  int runs = 0;
  std::function<void()> again = [] {};
  const Wake wake(context.get_executor(), std::chrono::milliseconds(0), [&] {
    if (++runs < 3) again();
  });
  again = wake;
  wake();
  context.run();
  EXPECT_EQ(runs, 3);
}

TEST(Wake, WaitsForItsDelay) {
  boost::asio::io_context context;
  int runs = 0;
  const Wake wake(context.get_executor(), std::chrono::hours(1), [&runs] { ++runs; });
  wake();
  EXPECT_EQ(context.poll(), 0u);
  wake();
  EXPECT_EQ(context.poll(), 0u);
  EXPECT_EQ(runs, 0);
}

}  // namespace
}  // namespace soundmap::api
