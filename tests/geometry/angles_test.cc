#include "geometry/angles.h"

#include <gtest/gtest.h>

namespace soundmap::geometry {
namespace {

TEST(Angles, NormalizedIsInTheHalfOpenCircleAndTheSameDirection) {
  for (int i = -2000; i <= 2000; ++i) {
    const double angle_rad = 0.0131 * i;
    const double normalized_rad = NormalizeAngle(angle_rad);
    EXPECT_GT(normalized_rad, -kPi);
    EXPECT_LE(normalized_rad, kPi);
    EXPECT_NEAR(std::cos(normalized_rad), std::cos(angle_rad), 1e-12);
    EXPECT_NEAR(std::sin(normalized_rad), std::sin(angle_rad), 1e-12);
  }
}

TEST(Angles, TheCutIsAtPlusPi) {
  EXPECT_EQ(NormalizeAngle(kPi), kPi);
  EXPECT_EQ(NormalizeAngle(-kPi), kPi);
  EXPECT_NEAR(NormalizeAngle(kPi + 0.1), -kPi + 0.1, 1e-12);
}

TEST(Angles, Degrees) {
  EXPECT_DOUBLE_EQ(RadFromDeg(180.0), kPi);
  EXPECT_DOUBLE_EQ(DegFromRad(RadFromDeg(-37.5)), -37.5);
}

}  // namespace
}  // namespace soundmap::geometry
