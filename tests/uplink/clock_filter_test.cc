#include "uplink/clock_filter.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace soundmap::uplink {
namespace {

constexpr std::int64_t kMs_ns = 1'000'000;
constexpr std::int64_t kSecond_ns = 1000 * kMs_ns;
constexpr std::int64_t kHour_ns = 3600 * kSecond_ns;

// Two clocks whose difference is known in closed form.
struct Clocks {
  std::int64_t offset_ns = 0;  // server minus robot at robot time 0
  double drift_ppm = 0.0;      // by which the server's runs faster

  std::int64_t ServerAt(std::int64_t robot_ns) const { return robot_ns + OffsetAt(robot_ns); }
  std::int64_t OffsetAt(std::int64_t robot_ns) const {
    return offset_ns + std::llround(1e-6 * drift_ppm * static_cast<double>(robot_ns));
  }
  // Delays by the robot's clock.
  TimeExchange Exchange(std::int64_t sent_ns, std::int64_t there_ns, std::int64_t at_server_ns,
                        std::int64_t back_ns) const {
    return {sent_ns, ServerAt(sent_ns + there_ns), ServerAt(sent_ns + there_ns + at_server_ns),
            sent_ns + there_ns + at_server_ns + back_ns};
  }
};

TEST(ClockFilter, EqualDelaysGiveTheOffsetItself) {
  const Clocks clocks{-5 * kHour_ns};
  ClockFilter filter;
  EXPECT_FALSE(filter.At(0));
  ASSERT_TRUE(filter.Add(clocks.Exchange(9 * kHour_ns, 10 * kMs_ns, 3 * kMs_ns, 10 * kMs_ns)));
  const auto estimate = filter.At(9 * kHour_ns);
  ASSERT_TRUE(estimate);
  EXPECT_EQ(estimate->server_minus_robot_ns, -5 * kHour_ns);
  EXPECT_NEAR(static_cast<double>(estimate->uncertainty_ns), 10.0 * kMs_ns, 1e3);
  // 100 ppm: 360 ms more in an hour.
  EXPECT_NEAR(static_cast<double>(filter.At(10 * kHour_ns)->uncertainty_ns), 370.0 * kMs_ns, 1e3);
}

TEST(ClockFilter, AllTheDelayOnOneWayIsStillWithinTheUncertainty) {
  const Clocks clocks{7 * kSecond_ns};
  for (const bool there : {true, false}) {
    ClockFilter filter;
    filter.Add(clocks.Exchange(kSecond_ns, there ? 501 : 0, 0, there ? 0 : 501));
    const auto estimate = filter.At(kSecond_ns);
    const std::int64_t error_ns = estimate->server_minus_robot_ns - 7 * kSecond_ns;
    EXPECT_EQ(std::abs(error_ns), there ? 251 : 250);
    EXPECT_LE(std::abs(error_ns), estimate->uncertainty_ns);
    EXPECT_EQ(estimate->uncertainty_ns, 251);
  }
}

// Delays between 1 ms and 2 s, each way on its own; an hour of exchanges.
TEST(ClockFilter, TheErrorIsWithinTheUncertaintyWhateverTheDelaysAndTheDrift) {
  std::mt19937_64 random(3);
  for (const double drift_ppm : {-100.0, -20.0, 0.0, 35.0, 99.0}) {
    const Clocks clocks{-kHour_ns, drift_ppm};
    ClockFilter filter;
    const auto delay_ns = [&random] {
      return std::llround(
          std::exp(std::uniform_real_distribution<double>(std::log(1e6), std::log(2e9))(random)));
    };
    struct Known {
      std::int64_t robot_ns;
      std::int64_t uncertainty_ns;
    };
    std::vector<Known> all;
    std::int64_t now_ns = 2 * kHour_ns;
    while (now_ns < 3 * kHour_ns) {
      const TimeExchange exchange =
          clocks.Exchange(now_ns, delay_ns(), random() % kMs_ns, delay_ns());
      ASSERT_TRUE(filter.Add(exchange));
      now_ns = exchange.robot_received_ns;
      const auto estimate = filter.At(now_ns);
      EXPECT_LE(std::abs(estimate->server_minus_robot_ns - clocks.OffsetAt(now_ns)),
                estimate->uncertainty_ns)
          << drift_ppm << " ppm at " << now_ns;
      // As well known as by the best of all exchanges, each of which is kept here.
      const std::int64_t round_trip_ns = exchange.robot_received_ns - exchange.robot_sent_ns -
                                         (exchange.server_sent_ns - exchange.server_received_ns);
      all.push_back({exchange.robot_sent_ns, (round_trip_ns + 1) / 2});
      double least_ns = std::numeric_limits<double>::max();
      for (const Known& known : all) {
        least_ns = std::min(least_ns, static_cast<double>(known.uncertainty_ns) +
                                          1e-4 * static_cast<double>(now_ns - known.robot_ns));
      }
      EXPECT_NEAR(static_cast<double>(estimate->uncertainty_ns), least_ns, 200.0);
      now_ns += 10 * kSecond_ns;
    }
  }
}

TEST(ClockFilter, AServersClockThatIsSetIsFollowedAtOnce) {
  for (const std::int64_t jump_ns : {kHour_ns, -kHour_ns, 20 * kMs_ns}) {
    Clocks clocks{3 * kHour_ns};
    ClockFilter filter;
    std::int64_t now_ns = kHour_ns;
    for (int i = 0; i < 20; ++i) {
      filter.Add(clocks.Exchange(now_ns += 10 * kSecond_ns, kMs_ns, 0, kMs_ns));
    }
    clocks.offset_ns += jump_ns;
    // Even by an exchange that is worse than the ones before.
    filter.Add(clocks.Exchange(now_ns += 10 * kSecond_ns, 6 * kMs_ns, 0, 8 * kMs_ns));
    const auto estimate = filter.At(now_ns);
    EXPECT_LE(std::abs(estimate->server_minus_robot_ns - clocks.offset_ns),
              estimate->uncertainty_ns);
    EXPECT_LE(estimate->uncertainty_ns, 8 * kMs_ns);
    // And the next good one makes it good.
    filter.Add(clocks.Exchange(now_ns += 10 * kSecond_ns, kMs_ns, 0, kMs_ns));
    EXPECT_EQ(filter.At(now_ns)->server_minus_robot_ns, clocks.offset_ns);
  }
}

TEST(ClockFilter, WhatCannotBeAnExchangeIsLeftOut) {
  constexpr std::int64_t kMax = std::numeric_limits<std::int64_t>::max();
  ClockFilter filter;
  const TimeExchange good{100, 5000, 5010, 200};
  for (const TimeExchange& bad : {TimeExchange{200, 5000, 5010, 100},   // back before it was sent
                                  TimeExchange{100, 5010, 5000, 200},   // the server's clock was
                                  TimeExchange{100, 5000, 5101, 200},   // set in between
                                  TimeExchange{-1, 5000, 5010, 200},    //
                                  TimeExchange{100, kMax, kMax, 200},   //
                                  TimeExchange{100, -kMax, kMax, 200},  //
                                  TimeExchange{100, 5000, 5010, kMax}}) {
    EXPECT_FALSE(filter.Add(bad));
    EXPECT_FALSE(filter.At(200));
  }
  EXPECT_TRUE(filter.Add(good));
  EXPECT_FALSE(filter.Add({300, kMax, kMax, 400}));
  EXPECT_EQ(filter.At(200)->server_minus_robot_ns, 5000 - 100 - 45);
}

}  // namespace
}  // namespace soundmap::uplink
