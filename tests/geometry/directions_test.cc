#include "geometry/directions.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::geometry {
namespace {

double SmallestAngle(const DirectionGrid& grid) {
  double largest_cosine = -1.0;
  for (int a = 0; a < grid.size(); ++a) {
    for (int b = 0; b < a; ++b) largest_cosine = std::max(largest_cosine, grid[a].dot(grid[b]));
  }
  return std::acos(std::min(1.0, largest_cosine));
}

TEST(Directions, AxesAndAnglesThereAndBack) {
  EXPECT_TRUE(DirectionFromAngles(0.0, 0.0).isApprox(Eigen::Vector3d::UnitX()));
  EXPECT_TRUE(DirectionFromAngles(kPi / 2.0, 0.0).isApprox(Eigen::Vector3d::UnitY()));
  EXPECT_TRUE(DirectionFromAngles(1.0, kPi / 2.0).isApprox(Eigen::Vector3d::UnitZ()));
  for (double azimuth_rad = -3.1; azimuth_rad < 3.1; azimuth_rad += 0.37) {
    for (double elevation_rad = -1.5; elevation_rad < 1.5; elevation_rad += 0.29) {
      const Eigen::Vector3d direction = DirectionFromAngles(azimuth_rad, elevation_rad);
      EXPECT_NEAR(direction.norm(), 1.0, 1e-12);
      const DirectionAngles angles = AnglesFromDirection(2.5 * direction);
      EXPECT_NEAR(angles.azimuth_rad, azimuth_rad, 1e-12);
      EXPECT_NEAR(angles.elevation_rad, elevation_rad, 1e-12);
    }
  }
}

TEST(DirectionGrid, ThePapersSectorHas4636Directions) {
  const auto grid = DirectionGrid::Sector(RadFromDeg(-45.0), RadFromDeg(15.0), RadFromDeg(0.0),
                                          RadFromDeg(75.0), RadFromDeg(1.0));
  EXPECT_EQ(grid.size(), 61 * 76);
  const DirectionAngles first = AnglesFromDirection(grid[0]);
  const DirectionAngles last = AnglesFromDirection(grid[grid.size() - 1]);
  EXPECT_NEAR(first.azimuth_rad, RadFromDeg(-45.0), 1e-9);
  EXPECT_NEAR(first.elevation_rad, 0.0, 1e-9);
  EXPECT_NEAR(last.azimuth_rad, RadFromDeg(15.0), 1e-9);
  EXPECT_NEAR(last.elevation_rad, RadFromDeg(75.0), 1e-9);
}

TEST(DirectionGrid, NoDirectionTwiceOnAClosedCircleOrAtAPole) {
  const auto grid = DirectionGrid::Sector(-kPi, kPi, -kPi / 2.0, kPi / 2.0, kPi / 12.0);
  EXPECT_EQ(grid.size(), 24 * 11 + 2);
  EXPECT_GT(SmallestAngle(grid), 0.03);
}

TEST(DirectionGrid, EqualAreaCoversTheSphereEvenly) {
  const auto two_degrees = DirectionGrid::EqualArea(RadFromDeg(2.0));
  EXPECT_EQ(two_degrees.size(), 10312);
  const double spacing_rad = RadFromDeg(6.0);
  const auto grid = DirectionGrid::EqualArea(spacing_rad);
  EXPECT_GT(SmallestAngle(grid), 0.7 * spacing_rad);
  // No place on the sphere is far from all directions, and the mean direction is none.
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& direction : grid) sum += direction;
  EXPECT_LT(sum.norm() / grid.size(), 1e-3);
  for (double azimuth_rad = -kPi; azimuth_rad < kPi; azimuth_rad += 0.11) {
    for (double elevation_rad = -1.5; elevation_rad < 1.55; elevation_rad += 0.13) {
      const Eigen::Vector3d wanted = DirectionFromAngles(azimuth_rad, elevation_rad);
      double largest_cosine = -1.0;
      for (const Eigen::Vector3d& direction : grid) {
        largest_cosine = std::max(largest_cosine, wanted.dot(direction));
      }
      EXPECT_LT(std::acos(std::min(1.0, largest_cosine)), 0.9 * spacing_rad);
    }
  }
}

}  // namespace
}  // namespace soundmap::geometry
