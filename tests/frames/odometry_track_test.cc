#include "frames/odometry_track.h"

#include <gtest/gtest.h>

#include <cmath>

#include "geometry/angles.h"

namespace soundmap::frames {
namespace {

using geometry::Pose2;

constexpr TimeNs kSecond_ns = 1'000'000'000;

// On a circle of 2 m at 0.5 rad/s.
Pose2 OnCircle(double time_s) {
  const double yaw_rad = 0.5 * time_s;
  return {2.0 * std::sin(yaw_rad), 2.0 * (1.0 - std::cos(yaw_rad)),
          geometry::NormalizeAngle(yaw_rad)};
}

OdometryTrack Circle(double duration_s, double keep_s = 30.0) {
  OdometryTrack track(keep_s);
  for (int i = 0; i <= std::lround(duration_s * 20.0); ++i) {
    EXPECT_TRUE(track.Add({kSecond_ns * i / 20, OnCircle(0.05 * i)}));
  }
  return track;
}

TEST(OdometryTrack, InterpolatesBetweenItsEntries) {
  const OdometryTrack track = Circle(10.0);
  for (double time_s = 0.0; time_s <= 10.0; time_s += 0.0137) {
    const auto pose = track.At(NsFromSeconds(time_s));
    ASSERT_TRUE(pose.has_value());
    // A chord of 5 cm leaves the circle by 0.2 mm.
    EXPECT_NEAR(pose->x_m, OnCircle(time_s).x_m, 2e-4);
    EXPECT_NEAR(pose->y_m, OnCircle(time_s).y_m, 2e-4);
    EXPECT_NEAR(geometry::NormalizeAngle(pose->yaw_rad - OnCircle(time_s).yaw_rad), 0.0, 1e-8);
  }
  EXPECT_EQ(*track.At(kSecond_ns), OnCircle(1.0));
}

TEST(OdometryTrack, NoneOutsideAndNearHoldsTheEnds) {
  const OdometryTrack track = Circle(1.0);
  EXPECT_FALSE(track.At(-1).has_value());
  EXPECT_FALSE(track.At(kSecond_ns + 1).has_value());
  EXPECT_EQ(*track.Near(kSecond_ns + kSecond_ns / 10, 0.2), OnCircle(1.0));
  EXPECT_EQ(*track.Near(-kSecond_ns / 10, 0.2), OnCircle(0.0));
  EXPECT_FALSE(track.Near(kSecond_ns + kSecond_ns / 4, 0.2).has_value());
  EXPECT_FALSE(OdometryTrack().At(0).has_value());
  EXPECT_FALSE(OdometryTrack().Near(0, 1.0).has_value());
}

TEST(OdometryTrack, RefusesWhatIsNotNewerOrNotFinite) {
  OdometryTrack track = Circle(1.0);
  const std::size_t size = track.entries().size();
  EXPECT_FALSE(track.Add({kSecond_ns, {9.0, 9.0, 0.0}}));
  EXPECT_FALSE(track.Add({kSecond_ns / 2, {9.0, 9.0, 0.0}}));
  EXPECT_FALSE(track.Add({2 * kSecond_ns, {std::nan(""), 0.0, 0.0}}));
  EXPECT_FALSE(track.Add({2 * kSecond_ns, {0.0, 0.0, INFINITY}}));
  EXPECT_EQ(track.entries().size(), size);
  EXPECT_EQ(*track.At(kSecond_ns), OnCircle(1.0));
}

TEST(OdometryTrack, ForgetsWhatIsOld) {
  const OdometryTrack track = Circle(100.0, /*keep_s=*/5.0);
  EXPECT_LE(track.entries().size(), 103u);
  EXPECT_TRUE(track.At(95 * kSecond_ns).has_value());
  EXPECT_FALSE(track.At(94 * kSecond_ns).has_value());
}

TEST(PointsInBaseAt, ASweepWhileDrivingLooksAsIfTakenAtOnce) {
  const OdometryTrack track = Circle(4.0);
  const Eigen::Isometry3d base_from_lidar =
      Eigen::Translation3d(0.1, -0.05, 1.2) * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY());
  const Eigen::Vector3d points_in_odom[] = {{5.0, 1.0, 0.3}, {-3.0, 2.0, 2.5}, {1.0, -4.0, 1.0}};
  LidarScan scan;
  scan.stamp_ns = 2 * kSecond_ns;
  for (std::uint32_t i = 0; i < 60; ++i) {
    const std::uint32_t offset_ns = i * 8'000'000;
    const Eigen::Isometry3d odom_from_lidar =
        OnCircle(2.0 + 1e-9 * offset_ns).ToIsometry() * base_from_lidar;
    scan.point_in_lidar.push_back(
        (odom_from_lidar.inverse() * points_in_odom[i % 3]).cast<float>());
    scan.time_offset_ns.push_back(offset_ns);
  }
  const auto points = PointsInBaseAt(scan, base_from_lidar, track, 2 * kSecond_ns + kSecond_ns / 4);
  ASSERT_TRUE(points.has_value());
  const Eigen::Isometry3d odom_from_reference = OnCircle(2.25).ToIsometry();
  for (std::size_t i = 0; i < points->size(); ++i) {
    const Eigen::Vector3d in_odom = odom_from_reference * (*points)[i].cast<double>();
    EXPECT_LT((in_odom - points_in_odom[i % 3]).norm(), 0.002) << i;
  }
}

TEST(PointsInBaseAt, WithoutOffsetsTheScanIsInstantaneous) {
  const OdometryTrack track = Circle(4.0);
  LidarScan scan;
  scan.stamp_ns = kSecond_ns;
  scan.point_in_lidar.push_back(Eigen::Vector3f(1.0f, 2.0f, 3.0f));
  const auto same = PointsInBaseAt(scan, Eigen::Isometry3d::Identity(), track, kSecond_ns);
  ASSERT_TRUE(same.has_value());
  EXPECT_LT(((*same)[0] - scan.point_in_lidar[0]).norm(), 1e-6f);
  // The scan and the reference must both lie within the track, give or take 0.2 s.
  EXPECT_TRUE(
      PointsInBaseAt(scan, Eigen::Isometry3d::Identity(), track, 4 * kSecond_ns + kSecond_ns / 10)
          .has_value());
  EXPECT_FALSE(
      PointsInBaseAt(scan, Eigen::Isometry3d::Identity(), track, 4 * kSecond_ns + kSecond_ns / 2)
          .has_value());
  LidarScan late = scan;
  late.stamp_ns = 5 * kSecond_ns;
  EXPECT_FALSE(PointsInBaseAt(late, Eigen::Isometry3d::Identity(), track, kSecond_ns).has_value());
}

}  // namespace
}  // namespace soundmap::frames
