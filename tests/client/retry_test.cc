#include "client-sdk/src/retry.h"

#include <gtest/gtest.h>

#include <random>

namespace soundmap::internal {
namespace {

using std::chrono::milliseconds;

constexpr RetryOptions kOptions{
    .max_attempts = 5, .initial_backoff = milliseconds(100), .max_backoff = milliseconds(350)};

// The limits double: 100, 200, then 350 instead of 400. A wait is uniform in [0, limit], so that
// its mean over many is limit / 2.
TEST(Backoff, IsFullJitterUnderADoublingLimit) {
  std::mt19937_64 random(7);
  const int limits_ms[] = {100, 200, 350, 350};
  double sums_ms[4] = {};
  std::int64_t longest_ms[4] = {};
  constexpr int kRuns = 4000;
  for (int run = 0; run < kRuns; ++run) {
    Backoff backoff(kOptions);
    for (int i = 0; i < 4; ++i) {
      const std::int64_t wait_ms = backoff.Next(random).count();
      ASSERT_GE(wait_ms, 0);
      ASSERT_LE(wait_ms, limits_ms[i]);
      sums_ms[i] += static_cast<double>(wait_ms);
      longest_ms[i] = std::max(longest_ms[i], wait_ms);
    }
  }
  for (int i = 0; i < 4; ++i) {
    // Standard error of the mean: limit / sqrt(12 * 4000) = 0.0046 limit.
    EXPECT_NEAR(sums_ms[i] / kRuns, 0.5 * limits_ms[i], 0.02 * limits_ms[i]) << i;
    EXPECT_GT(longest_ms[i], 0.98 * limits_ms[i]) << i;
  }
}

TEST(Backoff, StartsAnewAfterReset) {
  std::mt19937_64 random(7);
  Backoff backoff(kOptions);
  for (int i = 0; i < 10; ++i) backoff.Next(random);
  backoff.Reset();
  for (int i = 0; i < 1000; ++i) {
    ASSERT_LE(backoff.Next(random), milliseconds(100));
    backoff.Reset();
  }
}

}  // namespace
}  // namespace soundmap::internal
