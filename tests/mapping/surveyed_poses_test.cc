#include "mapping/surveyed_poses.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace soundmap::mapping {
namespace {

using geometry::Pose2;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

void ExpectNear(const Pose2& a, const Pose2& b) {
  EXPECT_NEAR(a.x_m, b.x_m, 1e-9);
  EXPECT_NEAR(a.y_m, b.y_m, 1e-9);
  EXPECT_NEAR(a.yaw_rad, b.yaw_rad, 1e-9);
}

frames::TimeNs At(double s) { return frames::NsFromSeconds(s); }

SurveyedPoses Followed(std::vector<StampedPose> poses, const std::vector<frames::Odometry>& track) {
  SurveyedPoses surveyed = SurveyedPoses::Create(std::move(poses)).value();
  frames::OdometryTrack odometry;
  for (const frames::Odometry& entry : track) {
    odometry.Add(entry);
    surveyed.Follow(odometry);
  }
  return surveyed;
}

TEST(SurveyedPoses, RefusesWhatDoesNotPlaceADrive) {
  EXPECT_TRUE(SurveyedPoses::Create({})->empty());
  EXPECT_FALSE(SurveyedPoses::Create({{1, {}}}).ok());
  EXPECT_FALSE(SurveyedPoses::Create({{1, {}}, {1, {}}}).ok());
  EXPECT_FALSE(SurveyedPoses::Create({{2, {}}, {1, {}}}).ok());
  EXPECT_FALSE(SurveyedPoses::Create({{1, {}}, {2, {kNan, 0, 0}}}).ok());
  EXPECT_FALSE(SurveyedPoses::Create({{-1, {}}, {2, {}}}).ok());
  EXPECT_FALSE(
      SurveyedPoses::Create({{1, {}}, {std::numeric_limits<frames::TimeNs>::max(), {}}}).ok());
  EXPECT_FALSE(SurveyedPoses::Create({{1, {}}, {2, {}}})->empty());
}

TEST(SurveyedPoses, NothingOutsideTheirSpan) {
  const SurveyedPoses surveyed = Followed({{At(1), {}}, {At(2), {}}}, {});
  EXPECT_FALSE(surveyed.At(At(0.999), {}));
  EXPECT_FALSE(surveyed.At(At(2.001), {}));
  EXPECT_TRUE(surveyed.At(At(1), {}));
  EXPECT_TRUE(surveyed.At(At(2), {}));
  EXPECT_FALSE(SurveyedPoses().At(At(1), {}));
}

TEST(SurveyedPoses, WithoutOdometryTheWayIsStraight) {
  const SurveyedPoses surveyed = Followed({{At(1), {0, 0, 3.0}}, {At(3), {4, 2, -3.0}}}, {});
  const auto middle = surveyed.At(At(2), {100, 100, 1});
  ASSERT_TRUE(middle);
  EXPECT_NEAR(middle->x_m, 2.0, 1e-12);
  EXPECT_NEAR(middle->y_m, 1.0, 1e-12);
  EXPECT_NEAR(std::abs(middle->yaw_rad), M_PI, 1e-12);  // the shorter way round
}

// The odometry's frame is turned and shifted against the map, and exact: every pose follows.
TEST(SurveyedPoses, ExactOdometryIsFollowedExactly) {
  const Pose2 odom_from_map{5, -3, 2.0};
  const auto truth = [](double s) {
    return Pose2{std::cos(0.4 * s), std::sin(0.4 * s), geometry::Pose2{0, 0, 0.4 * s}.yaw_rad};
  };
  std::vector<frames::Odometry> track;
  for (int i = 0; i <= 40; ++i) track.push_back({At(0.1 * i), odom_from_map * truth(0.1 * i)});
  const SurveyedPoses surveyed =
      Followed({{At(0.5), truth(0.5)}, {At(2.0), truth(2.0)}, {At(3.5), truth(3.5)}}, track);
  for (const double s : {0.5, 0.9, 1.7, 2.0, 2.6, 3.5}) {
    const auto pose = surveyed.At(At(s), odom_from_map * truth(s));
    ASSERT_TRUE(pose) << s;
    ExpectNear(*pose, truth(s));
  }
}

// Odometry that measures 10 % too much along a straight way: what is left is spread evenly.
TEST(SurveyedPoses, WhatIsLeftIsSpreadInTime) {
  const SurveyedPoses surveyed =
      Followed({{At(0), {0, 0, 0}}, {At(10), {10, 0, 0}}},
               {{At(0), {0, 0, 0}}, {At(4), {8.8, 0, 0}}, {At(10), {11, 0, 0}}});
  ExpectNear(*surveyed.At(At(4), {8.8, 0, 0}), {8.4, 0, 0});
}

}  // namespace
}  // namespace soundmap::mapping
