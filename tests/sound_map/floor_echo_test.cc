#include "sound_map/floor_echo.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

namespace soundmap::sound_map {
namespace {

constexpr double kWavesPerM = 40.0 / 343.0;
constexpr double kArray_m = 1.2;

// 1 + r^2 + 2 r cos(2 pi f d / c), without what does not ripple, for a source at that place.
frames::EchoRipple RippleOf(const Eigen::Vector3d& source, const Eigen::Vector3d& array) {
  const double straight_m = (source - array).norm();
  const double by_floor_m = std::hypot((source - array).head<2>().norm(), source.z() + array.z());
  frames::EchoRipple ripple{kWavesPerM, 3, {}};
  for (int bin = 3; bin <= 50; ++bin) {
    ripple.values.push_back(static_cast<std::int8_t>(std::lround(
        30.0 * std::cos(2.0 * std::numbers::pi * bin * kWavesPerM * (by_floor_m - straight_m)))));
  }
  return ripple;
}

// An array in a horizontal plane drives past a source and hears it at `heard`.
class FloorEchoTest : public ::testing::Test {
 protected:
  static FloorEcho Drive(const Eigen::Vector3d& source, const Eigen::Vector3d& heard,
                         int scans = 40) {
    FloorEcho echo;
    for (int scan = 0; scan < scans; ++scan) {
      const Eigen::Vector3d array(0.05 * (scan % 80), 0.0, kArray_m);
      HeardPeak peak;
      peak.place_in_map_m = source;
      peak.ripple = RippleOf(source, array);
      echo.Add({array, Eigen::Vector3d::UnitZ()}, heard, {&peak, 1});
    }
    return echo;
  }
};

TEST_F(FloorEchoTest, TellsASourceFromItsImage) {
  for (const double z_m : {0.4, 0.7, 1.7, 2.0}) {
    const Eigen::Vector3d source(1.0, 2.0, z_m), image(1.0, 2.0, 2.0 * kArray_m - z_m);
    const FloorEcho of_source = Drive(source, source), of_image = Drive(source, image);
    EXPECT_EQ(of_source.scans, 40.0);
    EXPECT_GT(of_source.Against(of_image), 6.0) << z_m;
    EXPECT_EQ(of_image.Against(of_source), -of_source.Against(of_image));
    EXPECT_GT(of_source.AgainstImage(), 6.0);
    EXPECT_LT(of_image.AgainstImage(), -6.0);
    EXPECT_NEAR(of_source.AtPlace() - of_image.AtPlace(),
                std::sqrt(2.0) * of_source.Against(of_image), 1e-9);
    EXPECT_NEAR((of_image.ImagePlace_in_map_m() - source).norm(), 0.0, 1e-6);
    // Its height is hardly known by its direction, but by its echo.
    const FloorEcho off = Drive(source, image + Eigen::Vector3d(0.0, 0.0, 0.2));
    EXPECT_NEAR((off.ImagePlace_in_map_m() - source).norm(), 0.0, 1e-6);
  }
}

TEST_F(FloorEchoTest, HearsThePeakInItsDirectionAlone) {
  const Eigen::Vector3d source(1.0, 2.0, 0.5), other(3.0, 2.0, 0.5);
  const Eigen::Vector3d array(1.0, 0.0, kArray_m);
  std::vector<HeardPeak> peaks(3);
  peaks[0].place_in_map_m = other;
  peaks[0].ripple = RippleOf(other, array);
  peaks[1].place_in_map_m = source + Eigen::Vector3d(0.1, 0.0, 0.0);
  peaks[1].ripple = RippleOf(source, array);
  peaks[2].place_in_map_m = source;  // without a ripple
  FloorEcho echo, alone;
  const ArrayPlane plane{array, Eigen::Vector3d::UnitZ()};
  echo.Add(plane, source, peaks);
  alone.Add(plane, source, {&peaks[1], 1});
  EXPECT_EQ(echo.scans, 1.0);
  EXPECT_EQ(echo, alone);
  FloorEcho nothing;
  nothing.Add(plane, source, {&peaks[0], 1});
  EXPECT_EQ(nothing, FloorEcho());
  EXPECT_EQ(nothing.Against(echo), 0.0);
  EXPECT_EQ(nothing.AgainstImage(), 0.0);
  EXPECT_EQ(nothing.AtPlace(), 0.0);
}

// A robot that stands still for an hour knows no more than one that stood there for a while.
TEST_F(FloorEchoTest, ManyScansSayNoMoreThanAHundred) {
  const Eigen::Vector3d source(1.0, 2.0, 0.5), image(1.0, 2.0, 1.9);
  const double of_100 = Drive(source, source, 100).Against(Drive(source, image, 100));
  const FloorEcho many = Drive(source, source, 5000);
  EXPECT_NEAR(many.Against(Drive(source, image, 5000)), of_100, 0.05 * of_100);
  EXPECT_LE(many.scans, 1024.0);
  const double from_image = Drive(source, image, 100).AgainstImage();
  EXPECT_NEAR(Drive(source, image, 5000).AgainstImage(), from_image, -0.05 * from_image);
}

// What ends on the floor itself has no echo: only the other place can be told.
TEST_F(FloorEchoTest, NothingIsBelowTheFloor) {
  const Eigen::Vector3d source(1.0, 2.0, 2.6);
  const FloorEcho of_source = Drive(source, source);
  EXPECT_LT(of_source.image_in_map_m.z(), 0.0);
  EXPECT_EQ(of_source.ImagePlace_in_map_m().z(),
            std::max(0.0, of_source.ImagePlace_in_map_m().z()));
  EXPECT_GT(of_source.AgainstImage(), 3.0);
}

}  // namespace
}  // namespace soundmap::sound_map
