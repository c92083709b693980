#include "geometry/pose.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "geometry/angles.h"

namespace soundmap::geometry {
namespace {

Pose2 RandomPose(std::mt19937_64& engine) {
  std::uniform_real_distribution<double> metres(-20.0, 20.0);
  std::uniform_real_distribution<double> angle(-kPi, kPi);
  const double x_m = metres(engine);
  const double y_m = metres(engine);
  return {x_m, y_m, angle(engine)};
}

// Against homogeneous matrices written out here.
Eigen::Matrix3d Matrix(const Pose2& pose) {
  Eigen::Matrix3d matrix;
  matrix << std::cos(pose.yaw_rad), -std::sin(pose.yaw_rad), pose.x_m,  //
      std::sin(pose.yaw_rad), std::cos(pose.yaw_rad), pose.y_m,         //
      0.0, 0.0, 1.0;
  return matrix;
}

TEST(Pose2, ProductAndInverseAreThoseOfTheMatrices) {
  std::mt19937_64 engine(1);
  for (int i = 0; i < 200; ++i) {
    const Pose2 a = RandomPose(engine);
    const Pose2 b = RandomPose(engine);
    EXPECT_TRUE(Matrix(a * b).isApprox(Matrix(a) * Matrix(b), 1e-12));
    EXPECT_TRUE((Matrix(a.Inverse()) * Matrix(a)).isApprox(Eigen::Matrix3d::Identity(), 1e-12));
    EXPECT_LE(std::abs((a * b).yaw_rad), kPi);
  }
}

TEST(Pose2, TheSameInSpace) {
  std::mt19937_64 engine(2);
  for (int i = 0; i < 100; ++i) {
    const Pose2 a = RandomPose(engine);
    const Pose2 b = RandomPose(engine);
    EXPECT_TRUE((a * b).ToIsometry().isApprox(a.ToIsometry() * b.ToIsometry(), 1e-12));
    const Pose2 back = ProjectToFloor(a.ToIsometry());
    EXPECT_NEAR(back.x_m, a.x_m, 1e-12);
    EXPECT_NEAR(back.y_m, a.y_m, 1e-12);
    EXPECT_NEAR(NormalizeAngle(back.yaw_rad - a.yaw_rad), 0.0, 1e-12);
  }
  // A quarter turn counter-clockwise takes x to y.
  EXPECT_TRUE((Pose2{0.0, 0.0, kPi / 2.0}.ToIsometry() * Eigen::Vector3d::UnitX())
                  .isApprox(Eigen::Vector3d::UnitY(), 1e-12));
}

TEST(Pose2, InterpolationTakesTheShorterArc) {
  const Pose2 begin{1.0, 2.0, kPi - 0.2};
  const Pose2 end{3.0, -2.0, -kPi + 0.4};
  const Pose2 middle = Interpolate(begin, end, 0.5);
  EXPECT_NEAR(middle.x_m, 2.0, 1e-12);
  EXPECT_NEAR(middle.y_m, 0.0, 1e-12);
  EXPECT_NEAR(NormalizeAngle(middle.yaw_rad - (-kPi + 0.1)), 0.0, 1e-12);
  EXPECT_NEAR(Interpolate(begin, end, 0.0).yaw_rad, begin.yaw_rad, 1e-12);
  EXPECT_NEAR(Interpolate(begin, end, 1.0).yaw_rad, end.yaw_rad, 1e-12);
}

}  // namespace
}  // namespace soundmap::geometry
