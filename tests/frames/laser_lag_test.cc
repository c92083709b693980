#include "frames/laser_lag.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace soundmap::frames {
namespace {

// Turns to and fro, once in 4 s, as fast as 1.2 rad/s.
double YawAt(double time_s) { return 0.76 * std::sin(0.5 * 3.14159265358979 * time_s); }

// Odometry at 20 Hz and the headings of scans at 5 Hz that are stamped `lag_s` late.
LaserLag Drive(double lag_s, double duration_s, double yaw_std_rad = 0.0, bool breaks = false) {
  LaserLag lag;
  OdometryTrack track;
  std::mt19937_64 engine(5);
  std::normal_distribution<double> normal;
  for (int i = 0; i * 0.05 < duration_s; ++i) {
    const double time_s = i * 0.05;
    track.Add({NsFromSeconds(100.0 + time_s), {0.0, 0.0, YawAt(time_s)}});
    if (i % 4 == 0) {
      if (breaks) lag.Break();
      lag.Add(NsFromSeconds(100.0 + time_s),
              0.4 + YawAt(time_s - lag_s) + yaw_std_rad * normal(engine));
    }
    lag.Follow(track);
  }
  return lag;
}

TEST(LaserLag, IsToldByTurns) {
  for (const double lag_s : {-0.08, 0.0, 0.033, 0.1, 0.25, 0.4}) {
    const auto exact = Drive(lag_s, 20.0).lag_s(0.015);
    ASSERT_TRUE(exact.has_value()) << lag_s;
    EXPECT_NEAR(*exact, lag_s, 0.002);
    const auto noisy = Drive(lag_s, 60.0, 0.01).lag_s(0.015);
    ASSERT_TRUE(noisy.has_value()) << lag_s;
    EXPECT_NEAR(*noisy, lag_s, 0.01);
  }
}

TEST(LaserLag, IsNotKnownBeforeTheTurnsTellIt) {
  EXPECT_FALSE(Drive(0.1, 1.0).lag_s(0.015).has_value());              // too few
  EXPECT_FALSE(Drive(0.1, 60.0, 0.5).lag_s(0.015).has_value());        // the scans say nothing
  EXPECT_FALSE(Drive(2.0, 60.0).lag_s(0.015).has_value());             // further than is looked
  EXPECT_FALSE(Drive(0.1, 60.0, 0.0, true).lag_s(0.015).has_value());  // no scan follows another
  LaserLag straight;
  OdometryTrack track;
  for (int i = 0; i < 2000; ++i) {
    track.Add({NsFromSeconds(0.1 * i), {0.05 * i, 0.0, 0.0}});
    straight.Add(NsFromSeconds(0.1 * i), 0.0);
    straight.Follow(track);
  }
  EXPECT_FALSE(straight.lag_s(0.015).has_value());
}

TEST(LaserLag, GoesOnFromItsState) {
  const LaserLag whole = Drive(0.1, 20.0, 0.003);
  LaserLag restored;
  ASSERT_TRUE(restored.Restore(whole.state()));
  EXPECT_EQ(restored.state(), whole.state());
  EXPECT_EQ(restored.lag_s(0.015), whole.lag_s(0.015));
  LaserLag::State broken = whole.state();
  broken.squared_error[3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(restored.Restore(broken));
  broken = whole.state();
  broken.waiting.resize(100'000);
  EXPECT_FALSE(restored.Restore(broken));
  EXPECT_EQ(restored.state(), whole.state());
}

}  // namespace
}  // namespace soundmap::frames
