#include "localization/motion_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

using geometry::Pose2;

constexpr int kDraws = 40000;

struct Moments {
  double mean[3] = {};
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

Moments Draw(const MotionModel& motion, const Pose2& start) {
  std::mt19937_64 engine(3);
  std::vector<Eigen::Vector3d> draws;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = 0; i < kDraws; ++i) {
    const Pose2 end = motion.Sample(start, engine);
    draws.emplace_back(end.x_m, end.y_m, geometry::NormalizeAngle(end.yaw_rad - start.yaw_rad));
    sum += draws.back();
  }
  Moments moments;
  const Eigen::Vector3d mean = sum / kDraws;
  for (int i = 0; i < 3; ++i) moments.mean[i] = mean[i];
  for (const Eigen::Vector3d& draw : draws) {
    moments.covariance += (draw - mean) * (draw - mean).transpose() / kDraws;
  }
  return moments;
}

TEST(MotionModel, StraightDriveFollowsTheFormula) {
  MotionNoise noise{0.04, 0.01, 0.0025, 0.01, 0.0, 0.0};
  const double drive_m = 0.5;
  const MotionModel motion(noise, {drive_m, 0.0, 0.0});
  const Moments moments = Draw(motion, {1.0, 2.0, geometry::kPi / 2.0});
  // alpha_2 alone turns, alpha_3 alone stretches.
  const double turn_std = std::sqrt(0.01) * drive_m;
  const double drive_std = std::sqrt(0.0025) * drive_m;
  EXPECT_NEAR(moments.mean[0], 1.0, 0.002);
  EXPECT_NEAR(moments.mean[1], 2.0 + drive_m * std::exp(-0.5 * turn_std * turn_std), 0.001);
  EXPECT_NEAR(std::sqrt(moments.covariance(1, 1)), drive_std, 0.02 * drive_std);
  EXPECT_NEAR(std::sqrt(moments.covariance(0, 0)), drive_m * turn_std, 0.02 * drive_m * turn_std);
  EXPECT_NEAR(std::sqrt(moments.covariance(2, 2)), std::sqrt(2.0) * turn_std, 0.02 * turn_std);
}

TEST(MotionModel, TurnOnTheSpotFollowsTheFormula) {
  const MotionNoise noise{0.04, 0.01, 0.0025, 0.01, 0.0, 0.0};
  const double turn_rad = 0.6;
  const MotionModel motion(noise, {0.0, 0.0, turn_rad});
  EXPECT_EQ(motion.first_turn_rad(), 0.0);
  const Moments moments = Draw(motion, {0.0, 0.0, 3.0});  // the mean passes the cut at pi
  EXPECT_NEAR(moments.mean[2], turn_rad, 0.003);
  EXPECT_NEAR(std::sqrt(moments.covariance(2, 2)), 0.2 * turn_rad, 0.003);
  const double position_std = std::sqrt(moments.covariance(0, 0) + moments.covariance(1, 1));
  EXPECT_NEAR(position_std, 0.1 * turn_rad, 0.002);  // alpha_4
}

TEST(MotionModel, WithoutNoiseItIsThePoseByOdometry) {
  const MotionNoise none{0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  std::mt19937_64 engine(1);
  const Pose2 start{2.0, -1.0, 2.5};
  for (const Pose2 step :
       {Pose2{0.3, 0.1, 0.4}, Pose2{-0.3, 0.1, 0.2}, Pose2{-0.2, 0.0, 0.0}, Pose2{0.0, 0.0, -1.0},
        Pose2{0.0, -0.2, 0.1}, Pose2{0.0005, 0.0, 0.3}, Pose2{-0.4, -0.1, 3.0}}) {
    const Pose2 expected = start * step;
    const Pose2 end = MotionModel(none, step).Sample(start, engine);
    EXPECT_NEAR(end.x_m, expected.x_m, 1e-3);
    EXPECT_NEAR(end.y_m, expected.y_m, 1e-3);
    EXPECT_NEAR(geometry::NormalizeAngle(end.yaw_rad - expected.yaw_rad), 0.0, 1e-9);
  }
}

TEST(MotionModel, ReverseIsNoHalfTurn) {
  const MotionNoise noise{0.04, 0.01, 0.0025, 0.01, 0.0, 0.0};
  const MotionModel forth(noise, {0.3, 0.02, 0.05});
  const MotionModel back(noise, {-0.3, 0.02, -0.05});
  EXPECT_NEAR(back.drive_m(), -forth.drive_m(), 1e-12);
  EXPECT_NEAR(back.first_turn_rad(), -forth.first_turn_rad(), 1e-12);
  EXPECT_NEAR(back.second_turn_std_rad(), forth.second_turn_std_rad(), 1e-12);
  EXPECT_LT(back.first_turn_std_rad(), 0.05);
}

TEST(MotionModel, StandingStillLeavesTheFloorOfTheNoise) {
  MotionNoise noise;
  noise.floor_position_m = 0.004;
  noise.floor_yaw_rad = 0.003;
  const Moments moments = Draw(MotionModel(noise, {0.0, 0.0, 0.0}), {1.0, 1.0, 0.5});
  EXPECT_NEAR(std::sqrt(moments.covariance(0, 0)), 0.004, 1e-4);
  EXPECT_NEAR(std::sqrt(moments.covariance(1, 1)), 0.004, 1e-4);
  EXPECT_NEAR(std::sqrt(moments.covariance(2, 2)), 0.003, 1e-4);
}

TEST(MotionModel, PropagatesTheCovarianceThatItDraws) {
  const MotionNoise noise{0.01, 0.01, 0.01, 0.002, 0.005, 0.003};
  const MotionModel motion(noise, {0.4, 0.1, 0.3});
  const Pose2 start{1.0, 2.0, -0.7};
  const Eigen::Matrix3d predicted = motion.Propagate(start, Eigen::Matrix3d::Zero());
  const Eigen::Matrix3d drawn = Draw(motion, start).covariance;
  EXPECT_LT((predicted - drawn).norm(), 0.03 * drawn.norm());

  // A yaw that is off by d moves the end by d across the drive.
  Eigen::Matrix3d start_covariance = Eigen::Matrix3d::Zero();
  start_covariance(2, 2) = 0.01;
  const Eigen::Matrix3d added = motion.Propagate(start, start_covariance) - predicted;
  EXPECT_NEAR(added(0, 0) + added(1, 1), 0.01 * (0.4 * 0.4 + 0.1 * 0.1), 1e-9);
  EXPECT_NEAR(added(2, 2), 0.01, 1e-12);
}

}  // namespace
}  // namespace soundmap::localization
