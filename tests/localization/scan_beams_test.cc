#include "localization/scan_beams.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "geometry/angles.h"
#include "synthetic_room.h"

namespace soundmap::localization {
namespace {

using geometry::Pose2;

constexpr frames::TimeNs kSecond_ns = 1'000'000'000;

frames::OdometryTrack Track(double speed_mps, double turn_rate_radps) {
  frames::OdometryTrack track;
  for (int i = 0; i <= 100; ++i) {
    const double time_s = 0.01 * i;
    const double yaw_rad = turn_rate_radps * time_s;
    // An arc in closed form.
    const double x_m = turn_rate_radps == 0.0 ? speed_mps * time_s
                                              : speed_mps / turn_rate_radps * std::sin(yaw_rad);
    const double y_m =
        turn_rate_radps == 0.0 ? 0.0 : speed_mps / turn_rate_radps * (1.0 - std::cos(yaw_rad));
    track.Add({kSecond_ns / 100 * i, {x_m, y_m, yaw_rad}});
  }
  return track;
}

Eigen::Vector2d EndInBase(const Beam& beam) {
  return beam.origin_in_base_m + beam.range_m * beam.direction_in_base;
}

TEST(ScanBeams, LeavesOutWhatIsNoReturn) {
  frames::LaserScan scan{kSecond_ns / 2, 0.0, 0.1, {1.0f, NAN, INFINITY, 0.0f, -3.0f, 0.01f, 2.0f}};
  const auto beams = ValidBeams(scan, LaserInFront(), 0.0, 0.05, Track(0.0, 0.0));
  ASSERT_TRUE(beams.has_value());
  ASSERT_EQ(beams->size(), 2u);
  EXPECT_NEAR(EndInBase((*beams)[0]).x(), 1.2, 1e-9);
  EXPECT_NEAR(EndInBase((*beams)[1]).x(), 0.2 + 2.0 * std::cos(0.6), 1e-6);
  EXPECT_NEAR(EndInBase((*beams)[1]).y(), 2.0 * std::sin(0.6), 1e-6);
}

TEST(ScanBeams, ALaserUpsideDownAndTurnedSeesTheSameWall) {
  frames::Calibration calibration;
  calibration.base_from_laser = Eigen::Translation3d(0.1, -0.2, 0.4) *
                                Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ()) *
                                Eigen::AngleAxisd(geometry::kPi, Eigen::Vector3d::UnitX());
  frames::LaserScan scan{kSecond_ns / 2, -0.5, 0.01, {}};
  for (int i = 0; i < 100; ++i) {
    // Upside down the beams turn clockwise: beam angle a points to 0.7 - a in base. Wall at x = 3.
    const double direction_rad = 0.7 - (scan.start_angle_rad + i * scan.angle_increment_rad);
    scan.range_m.push_back(static_cast<float>((3.0 - 0.1) / std::cos(direction_rad)));
  }
  const auto beams = ValidBeams(scan, calibration, 0.0, 0.05, Track(0.0, 0.0));
  ASSERT_TRUE(beams.has_value());
  for (const Beam& beam : *beams) EXPECT_NEAR(EndInBase(beam).x(), 3.0, 1e-5);
}

TEST(ScanBeams, MovesEachBeamByTheOdometrySinceItsTime) {
  frames::Calibration calibration = LaserInFront();
  calibration.laser_time_increment_s = 0.001;
  const double lag_s = 0.05;
  const double speed_mps = 1.0;
  const double turn_rate_radps = 0.8;
  const frames::OdometryTrack track = Track(speed_mps, turn_rate_radps);
  frames::LaserScan scan{kSecond_ns / 2, -0.6, 0.006, {}};
  const int beams_of_scan = 200;
  // A wall at x = 4 of odom, seen from where the laser was at each beam's time.
  for (int i = 0; i < beams_of_scan; ++i) {
    const double time_s = 0.5 - lag_s + 0.001 * i;
    const double yaw_rad = turn_rate_radps * time_s;
    const double laser_x_m =
        speed_mps / turn_rate_radps * std::sin(yaw_rad) + 0.2 * std::cos(yaw_rad);
    scan.range_m.push_back(
        static_cast<float>((4.0 - laser_x_m) / std::cos(yaw_rad - 0.6 + 0.006 * i)));
  }
  const auto beams = ValidBeams(scan, calibration, lag_s, 0.05, track);
  ASSERT_TRUE(beams.has_value());
  const frames::TimeNs middle_ns = MiddleOf(scan, 0.001, lag_s);
  EXPECT_EQ(middle_ns, kSecond_ns / 2 + kSecond_ns / 20);
  const Eigen::Isometry3d odom_from_middle = track.At(middle_ns)->ToIsometry();
  for (const Beam& beam : *beams) {
    const Eigen::Vector2d end = EndInBase(beam);
    EXPECT_NEAR((odom_from_middle * Eigen::Vector3d(end.x(), end.y(), 0.0)).x(), 4.0, 2e-4);
  }
  // The odometry must reach over the sweep.
  scan.stamp_ns = kSecond_ns - kSecond_ns / 10;
  EXPECT_FALSE(ValidBeams(scan, calibration, lag_s, 0.05, track).has_value());
}

TEST(ScanBeams, SubsamplesEvenlyAmongTheValidOnes) {
  std::vector<Beam> beams(541);
  for (int i = 0; i < 541; ++i) beams[i].range_m = i;
  const auto chosen = Subsample(beams, 60);
  ASSERT_EQ(chosen.size(), 60u);
  EXPECT_LT(chosen.front().range_m, 9.0);
  EXPECT_GT(chosen.back().range_m, 531.0);
  for (int i = 1; i < 60; ++i) {
    EXPECT_NEAR(chosen[i].range_m - chosen[i - 1].range_m, 541.0 / 60.0, 1.0);
  }
  EXPECT_EQ(Subsample(beams, 600).size(), 541u);
}

}  // namespace
}  // namespace soundmap::localization
