#include "sources/simulation/trajectory.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace soundmap::simulation {
namespace {

PathConfig Square() {
  PathConfig path;
  path.way_points_m = {{1, 1}, {5, 1}, {5, 4}, {1, 4}};
  path.speed_mps = {0.6, 0.6, 0.6, 0.6};
  path.closed = true;
  return path;
}

TEST(Trajectory, StaysInTheHullHeadsAlongItselfAndKeepsItsBounds) {
  const PathConfig path = Square();
  const auto trajectory = Trajectory::Create(path, 2.0);
  ASSERT_TRUE(trajectory.ok()) << trajectory.status();
  constexpr double kStepS = 0.01;
  double fastest_mps = 0.0, last_mps = 0.0;
  for (double t = 0.0; t + 2 * kStepS < trajectory->duration_s(); t += kStepS) {
    const auto a = trajectory->At(t), b = trajectory->At(t + kStepS);
    ASSERT_TRUE(a.x_m >= 1 && a.x_m <= 5 && a.y_m >= 1 && a.y_m <= 4);
    const double speed_mps = std::hypot(b.x_m - a.x_m, b.y_m - a.y_m) / kStepS;
    fastest_mps = std::max(fastest_mps, speed_mps);
    EXPECT_LE(std::abs(b.yaw_rad - a.yaw_rad) / kStepS, 1.2 * path.max_yaw_rate_radps);
    if (speed_mps > 0.05) {
      const double course_rad = std::atan2(b.y_m - a.y_m, b.x_m - a.x_m);
      EXPECT_LT(std::abs(std::remainder(course_rad - a.yaw_rad, 2 * std::numbers::pi)), 0.05);
      EXPECT_LT(std::abs(speed_mps - last_mps) / kStepS, 2 * path.acceleration_mps2 + 0.3) << t;
    }
    last_mps = speed_mps;
  }
  EXPECT_NEAR(fastest_mps, 0.6, 0.01);
}

TEST(Trajectory, TurnsFullyOncePerLapAndEndsWhereItBegan) {
  const auto trajectory = Trajectory::Create(Square(), 3.0);
  ASSERT_TRUE(trajectory.ok());
  const auto start = trajectory->At(0.0), end = trajectory->At(1e9);
  EXPECT_NEAR(end.yaw_rad - start.yaw_rad, 3 * 2 * std::numbers::pi, 1e-6);  // counter-clockwise
  EXPECT_NEAR(end.x_m, start.x_m, 1e-9);
  EXPECT_NEAR(end.y_m, start.y_m, 1e-9);
}

TEST(Trajectory, OpenPathRunsFromItsFirstToItsLastWayPoint) {
  PathConfig path;
  path.way_points_m = {{1, 1}, {3, 1}, {3, 4}};
  path.speed_mps = {1.0, 0.3, 0.3};
  path.closed = false;
  const auto trajectory = Trajectory::Create(path, 1.0);
  ASSERT_TRUE(trajectory.ok());
  EXPECT_NEAR(trajectory->At(-1.0).x_m, 1.0, 1e-9);
  EXPECT_NEAR(trajectory->At(1e9).x_m, 3.0, 1e-9);
  EXPECT_NEAR(trajectory->At(1e9).y_m, 4.0, 1e-9);
  EXPECT_NEAR(trajectory->At(1e9).yaw_rad, std::numbers::pi / 2, 1e-6);
  EXPECT_GT(trajectory->duration_s(), 3.0 / 0.3);
}

TEST(Trajectory, StandsAtASingleWayPoint) {
  PathConfig path;
  path.way_points_m = {{2, 3}};
  path.speed_mps = {1.0};
  path.standing_yaw_rad = 0.7;
  EXPECT_FALSE(Trajectory::Create(path, 1.0).ok());
  path.standing_s = 4.0;
  const auto trajectory = Trajectory::Create(path, 1.0);
  ASSERT_TRUE(trajectory.ok());
  EXPECT_EQ(trajectory->duration_s(), 4.0);
  EXPECT_EQ(trajectory->At(2.0).yaw_rad, 0.7);
}

TEST(Trajectory, RefusesPathsThatCannotBeDriven) {
  PathConfig path = Square();
  path.way_points_m.assign(4, {1, 1});
  EXPECT_FALSE(Trajectory::Create(path, 1.0).ok());
  path = Square();
  EXPECT_FALSE(Trajectory::Create(path, 1e6).ok());
  EXPECT_FALSE(Trajectory::Create(path, std::nan("")).ok());
  path.way_points_m.clear();
  path.speed_mps.clear();
  EXPECT_FALSE(Trajectory::Create(path, 1.0).ok());
}

}  // namespace
}  // namespace soundmap::simulation
