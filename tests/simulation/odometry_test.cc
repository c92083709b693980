#include <gtest/gtest.h>

#include <cmath>

#include "sources/simulation/random_streams.h"
#include "sources/simulation/wheel_odometry.h"

namespace soundmap::simulation {
namespace {

struct Statistics {
  double mean, deviation;
};

Statistics Of(const std::vector<double>& values) {
  double mean = 0.0, square = 0.0;
  for (double value : values) mean += value / values.size();
  for (double value : values) square += (value - mean) * (value - mean) / (values.size() - 1);
  return {mean, std::sqrt(square)};
}

// 10 m straight ahead from a place of no meaning to odometry, in steps of `step_m`.
PlanarPose Drive(const OdometryConfig& config, double step_m, int seed) {
  const double heading_rad = 2.0;
  WheelOdometry odometry(config, {3.0, 1.0, heading_rad},
                         MakeEngine(seed, RandomStream::kOdometry));
  PlanarPose pose;
  for (int i = 1; i <= std::lround(10.0 / step_m); ++i) {
    const double way_m = i * step_m;
    pose = odometry.Step(
        {3.0 + way_m * std::cos(heading_rad), 1.0 + way_m * std::sin(heading_rad), heading_rad});
  }
  return pose;
}

TEST(WheelOdometry, DriftHasTheMeanAndSpreadOfItsModelAtAnyRate) {
  OdometryConfig config;
  config.yaw_drift_rad_per_m = 0.003;
  constexpr int kDrives = 400;
  for (double step_m : {0.025, 0.1}) {
    std::vector<double> yaw_rad, ahead_m;
    for (int seed = 0; seed < kDrives; ++seed) {
      yaw_rad.push_back(Drive(config, step_m, seed).yaw_rad);
      OdometryConfig straight = config;
      straight.yaw_drift_rad_per_m = straight.yaw_noise_rad_per_sqrt_m = 0.0;
      ahead_m.push_back(Drive(straight, step_m, seed).x_m);
    }
    const double yaw_sigma = config.yaw_noise_rad_per_sqrt_m * std::sqrt(10.0);
    const double way_sigma = config.translation_noise_m_per_sqrt_m * std::sqrt(10.0);
    EXPECT_NEAR(Of(yaw_rad).mean, 0.03, 4 * yaw_sigma / std::sqrt(kDrives));
    EXPECT_NEAR(Of(yaw_rad).deviation, yaw_sigma, 0.15 * yaw_sigma);
    EXPECT_NEAR(Of(ahead_m).mean, 10.1, 4 * way_sigma / std::sqrt(kDrives));
    EXPECT_NEAR(Of(ahead_m).deviation, way_sigma, 0.15 * way_sigma);
  }
}

TEST(WheelOdometry, WithoutErrorsItIsTheMotionSinceTheStart) {
  OdometryConfig exact{20.0, 1.0, 1.0, 0.0, 0.0, 0.0};
  const PlanarPose start{2.0, 5.0, 0.8};
  WheelOdometry odometry(exact, start, MakeEngine(1, RandomStream::kOdometry));
  PlanarPose truth = start, measured;
  for (int i = 0; i < 100; ++i) {
    truth.yaw_rad += 0.03;
    truth.x_m += 0.05 * std::cos(truth.yaw_rad);
    truth.y_m += 0.05 * std::sin(truth.yaw_rad);
    measured = odometry.Step(truth);
  }
  const Eigen::Isometry3d expected = start.map_from_base().inverse() * truth.map_from_base();
  EXPECT_TRUE(measured.map_from_base().isApprox(expected, 1e-9));
}

TEST(WheelOdometry, ARobotThatStandsDoesNotDrift) {
  WheelOdometry odometry({}, {1, 2, 3}, MakeEngine(1, RandomStream::kOdometry));
  PlanarPose pose;
  for (int i = 0; i < 1000; ++i) pose = odometry.Step({1, 2, 3});
  EXPECT_EQ(pose.x_m, 0.0);
  EXPECT_EQ(pose.yaw_rad, 0.0);
}

}  // namespace
}  // namespace soundmap::simulation
