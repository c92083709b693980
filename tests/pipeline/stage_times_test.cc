#include "pipeline/stage_times.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <ctime>
#include <set>
#include <string>
#include <thread>
#include <vector>

namespace soundmap::pipeline {
namespace {

std::int64_t ThreadCpu_ns() {
  timespec time = {};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return time.tv_sec * std::int64_t{1'000'000'000} + time.tv_nsec;
}

void WorkFor(std::int64_t cpu_ns) {
  const std::int64_t begin = ThreadCpu_ns();
  while (ThreadCpu_ns() - begin < cpu_ns) {
  }
}

std::int64_t Sum(const StageTimes& times) {
  std::int64_t sum = 0;
  for (int i = 0; i < kStages; ++i) sum += times.cpu_time(static_cast<Stage>(i)).count();
  return sum;
}

TEST(StageTimes, EveryStageHasANameOfItsOwn) {
  std::set<std::string> names;
  for (int i = 0; i < kStages; ++i) names.insert(NameOf(static_cast<Stage>(i)));
  EXPECT_EQ(names.size(), kStages);
}

TEST(StageClock, TheStagesSumToTheProcessorTimeOfTheThread) {
  StageTimes times;
  StageClock clock(&times);
  const std::int64_t begin = ThreadCpu_ns();
  clock.Start();
  WorkFor(3'000'000);
  clock.Lap(Stage::kMap);
  WorkFor(1'000'000);
  clock.Stop(Stage::kSession);
  const std::int64_t all = ThreadCpu_ns() - begin;
  EXPECT_GE(Sum(times), 4'000'000 - kStages);
  EXPECT_LE(Sum(times), all);
  EXPECT_GT(times.cpu_time(Stage::kMap).count(), 0);
  EXPECT_GT(times.cpu_time(Stage::kSession).count(), 0);
  EXPECT_EQ(times.cpu_time(Stage::kCast).count(), 0);
}

TEST(StageClock, OtherThreadsAndWaitingDoNotCount) {
  StageTimes times;
  StageClock clock(&times);
  const std::int64_t begin = ThreadCpu_ns();
  clock.Start();
  std::thread([] { WorkFor(30'000'000); }).join();
  clock.Lap(Stage::kMap);
  clock.Stop(Stage::kSession);
  EXPECT_LE(Sum(times), ThreadCpu_ns() - begin);
}

TEST(StageClock, MeasuresNothingUnlessStarted) {
  StageTimes times;
  StageClock clock(&times);
  WorkFor(1'000'000);
  clock.Lap(Stage::kMap);
  clock.Stop(Stage::kMap);
  EXPECT_EQ(Sum(times), 0);
  clock.Start();
  clock.Stop(Stage::kSession);
  const std::int64_t after = Sum(times);
  clock.Lap(Stage::kMap);
  clock.Stop(Stage::kMap);
  EXPECT_EQ(Sum(times), after);

  StageClock unheard(nullptr);
  unheard.Start();
  unheard.Lap(Stage::kMap);
  unheard.Stop(Stage::kMap);
}

TEST(StageTimes, ThreadsAddTogether) {
  StageTimes times;
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&times] {
      for (int i = 0; i < 10'000; ++i) times.Add(Stage::kMap, std::chrono::nanoseconds(3));
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(times.cpu_time(Stage::kMap).count(), 120'000);
}

}  // namespace
}  // namespace soundmap::pipeline
