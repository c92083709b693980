#include "mapping/odometry_scale.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "geometry/angles.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;

// Laps of a circle of 2 m; the odometry measures each step too short and turns too far.
std::vector<MappedOdometry> Laps(double laps, double translation, double rotation, double noise_m) {
  std::mt19937 engine(3);
  std::normal_distribution<double> noise(0.0, 1.0);
  std::vector<MappedOdometry> drive = {{{3.0, -1.0, 2.0}, {10.0, 5.0, -1.0}}};
  Pose2 map_from_base = drive.front().map_from_base;
  for (double turned_rad = 0.0; turned_rad < laps * 2.0 * geometry::kPi; turned_rad += 0.1) {
    map_from_base = map_from_base * Pose2{0.2, 0.0, 0.1};
    const Pose2 step{0.2 / translation, 0.0, 0.1 / rotation};
    drive.push_back({drive.back().odom_from_base * step,
                     map_from_base * Pose2{noise_m * noise(engine), noise_m * noise(engine),
                                           0.2 * noise_m * noise(engine)}});
  }
  return drive;
}

TEST(OdometryScale, IsFoundAmongTheNoiseOfTheMap) {
  const OdometryScale scale = ScaleOf(Laps(3.0, 1.03, 0.97, 0.02));
  EXPECT_NEAR(scale.translation, 1.03, 0.01);
  EXPECT_NEAR(scale.rotation, 0.97, 0.01);
  const Pose2 corrected = scale.Corrected({1.0 / 1.03, 0.0, 0.5 / 0.97});
  EXPECT_NEAR(corrected.x_m, 1.0, 0.01);
  EXPECT_NEAR(corrected.yaw_rad, 0.5, 0.01);
}

TEST(OdometryScale, OfTooLittleOrOfSlippingWheelsIsOne) {
  for (const auto& drive :
       {std::vector<MappedOdometry>{}, Laps(0.5, 1.03, 0.97, 0.0), Laps(3.0, 1.4, 0.7, 0.0)}) {
    const OdometryScale scale = ScaleOf(drive);
    EXPECT_EQ(scale.translation, 1.0);
    EXPECT_EQ(scale.rotation, 1.0);
  }
}

}  // namespace
}  // namespace soundmap::mapping
