#include "sound_map/registered_source.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <random>

namespace soundmap::sound_map {
namespace {

constexpr double kOneDirection_rad = 12.0 * std::numbers::pi / 180.0;

class ViewPointTest : public ::testing::Test {
 protected:
  Eigen::Vector3d Vector() { return {normal_(random_), normal_(random_), normal_(random_)}; }
  Eigen::Vector3d Direction() { return Vector().normalized(); }
  double Uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  // So far away from this angle that rounding does not decide.
  static bool IsClear(double angle_rad) { return std::abs(angle_rad - kOneDirection_rad) > 1e-6; }

  std::mt19937 random_{11};
  std::normal_distribution<double> normal_;
};

double AngleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// However far away the places are.
TEST_F(ViewPointTest, InSpaceTheAngleBetweenTwoPlacesTells) {
  int near = 0;
  for (int trial = 0; trial < 1000; ++trial) {
    ViewPoint view_point;
    const Eigen::Vector3d array = Vector();
    view_point.AddArray(array, std::nullopt);
    const Eigen::Vector3d direction = Direction();
    const Eigen::Vector3d other = (direction + 0.3 * Uniform(0.0, 1.0) * Vector()).normalized();
    const double angle_rad = AngleBetween(direction, other);
    if (!IsClear(angle_rad)) continue;
    const bool is_one = angle_rad < kOneDirection_rad;
    EXPECT_EQ(view_point.InOneDirection(array + Uniform(0.3, 9.0) * direction,
                                        array + Uniform(0.3, 9.0) * other),
              is_one);
    near += is_one;
  }
  EXPECT_GT(near, 300);
  EXPECT_LT(near, 700);
}

// What reaches an array in a plane along two axes of the plane with the same delays is one to it.
TEST_F(ViewPointTest, InAPlaneWhatIsAlikeAlongThePlaneIsOne) {
  int near = 0;
  for (int trial = 0; trial < 1000; ++trial) {
    ViewPoint view_point;
    const ArrayPlane plane{Vector(), Direction()};
    view_point.AddArray(plane.origin_in_map_m, plane);
    const Eigen::Vector3d east = plane.normal_in_map.unitOrthogonal();
    const Eigen::Vector3d north = plane.normal_in_map.cross(east);
    const Eigen::Vector3d direction = Direction();
    Eigen::Vector3d other = (direction + 0.3 * Uniform(0.0, 1.0) * Vector()).normalized();
    if (trial % 2 == 0) {  // on the other side
      other -= 2.0 * other.dot(plane.normal_in_map) * plane.normal_in_map;
    }
    const double off = std::hypot(east.dot(direction - other), north.dot(direction - other));
    if (!IsClear(std::asin(std::min(1.0, off)))) continue;
    const bool is_one = off < std::sin(kOneDirection_rad);
    EXPECT_EQ(view_point.InOneDirection(plane.origin_in_map_m + Uniform(0.3, 9.0) * direction,
                                        plane.origin_in_map_m + Uniform(0.3, 9.0) * other),
              is_one);
    near += is_one;
  }
  EXPECT_GT(near, 300);
  EXPECT_LT(near, 900);
}

// Where a wall mirrors, the way by the wall is the shortest one: found by going downhill.
Eigen::Vector3d ShortestWayBy(const Eigen::Vector3d& on_wall, const Eigen::Vector3d& normal,
                              const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  const Eigen::Vector3d east = normal.unitOrthogonal();
  const Eigen::Vector3d north = normal.cross(east);
  Eigen::Vector3d by = on_wall;
  const auto way_m = [&](const Eigen::Vector3d& p) { return (p - from).norm() + (p - to).norm(); };
  for (double step_m = 4.0; step_m > 1e-7; step_m /= 2.0) {
    for (bool shorter = true; shorter;) {
      shorter = false;
      for (const Eigen::Vector3d& step :
           {east, north, Eigen::Vector3d(-east), Eigen::Vector3d(-north)}) {
        if (way_m(by + step_m * step) >= way_m(by)) continue;
        by += step_m * step;
        shorter = true;
      }
    }
  }
  return by;
}

TEST_F(ViewPointTest, ASurfaceMirrorsAPlaceWhereTheWayByItIsTheShortest) {
  int mirrored = 0;
  int beside = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const Eigen::Vector3d normal = Direction();
    const Eigen::Vector3d on_wall = Vector();
    const Eigen::Vector3d along = normal.unitOrthogonal();
    const Eigen::Vector3d array = on_wall + Uniform(0.5, 4.0) * normal + Uniform(-3.0, 3.0) * along;
    const Eigen::Vector3d other = on_wall + Uniform(0.5, 4.0) * normal + Uniform(-3.0, 3.0) * along;
    ViewPoint view_point;
    view_point.AddArray(array, std::nullopt);
    const Eigen::Vector3d mirror = ShortestWayBy(on_wall, normal, array, other);
    EXPECT_FALSE(view_point.Mirrors(mirror, other));  // how the surface lies is not known
    view_point.surface_normal_sum_in_map = Uniform(0.9, 40.0) * normal;
    EXPECT_TRUE(view_point.Mirrors(mirror, other));
    const Eigen::Vector3d place = mirror + Uniform(-3.0, 3.0) * along;
    const double angle_rad = AngleBetween(place - array, mirror - array);
    if (IsClear(angle_rad)) {
      EXPECT_EQ(view_point.Mirrors(place, other), angle_rad < kOneDirection_rad);
      ++(angle_rad < kOneDirection_rad ? mirrored : beside);
    }
    // What is behind the surface or on it has no image in it, and from behind none is heard.
    const double height_m = (other - on_wall).dot(normal);
    EXPECT_FALSE(view_point.Mirrors(mirror, other - 2.0 * height_m * normal));
    EXPECT_FALSE(view_point.Mirrors(mirror, other - (height_m - 0.2) * normal));
    view_point.surface_normal_sum_in_map *= -1.0;
    EXPECT_FALSE(view_point.Mirrors(mirror, other));
    const Eigen::Vector3d image = other - 2.0 * height_m * normal;
    ViewPoint behind;
    behind.AddArray(mirror + 2.0 * (image - mirror), std::nullopt);
    behind.surface_normal_sum_in_map = normal;
    EXPECT_FALSE(behind.Mirrors(mirror, other));
    // Arrays in a plane do not tell.
    ViewPoint in_plane;
    in_plane.AddArray(array, ArrayPlane{array, Eigen::Vector3d::UnitZ()});
    in_plane.surface_normal_sum_in_map = normal;
    EXPECT_FALSE(in_plane.Mirrors(mirror, other));
  }
  EXPECT_GT(mirrored, 50);
  EXPECT_GT(beside, 50);
}

TEST_F(ViewPointTest, AnArrayInSpaceTakesThePlaceOfOneInAPlane) {
  const ArrayPlane plane{{1.0, 2.0, 1.2}, Eigen::Vector3d::UnitZ()};
  ViewPoint view_point;
  view_point.AddArray({1.0, 2.0, 1.2}, plane);
  view_point.AddArray({1.1, 2.0, 0.4}, ArrayPlane{{1.1, 2.0, 0.4}, Eigen::Vector3d::UnitX()});
  EXPECT_EQ(view_point.array_in_map_m.z(), 1.2);
  const Eigen::Vector3d above(4.0, 2.0, 2.2);
  const Eigen::Vector3d below(4.0, 2.0, 0.2);
  EXPECT_TRUE(view_point.InOneDirection(above, below));
  view_point.AddArray({1.0, 2.3, 1.2}, std::nullopt);
  EXPECT_FALSE(view_point.InOneDirection(above, below));
  view_point.AddArray({1.0, 2.0, 1.2}, plane);
  EXPECT_FALSE(view_point.InOneDirection(above, below));
  EXPECT_EQ(view_point.array_in_map_m.y(), 2.3);
}

TEST(RegisteredSource, IsHeardInPlanesAloneWhereNoArrayInSpaceIsKnown) {
  RegisteredSource source;
  EXPECT_FALSE(source.HeardInPlanesAlone());
  source.view_points.resize(2);
  EXPECT_FALSE(source.HeardInPlanesAlone());
  source.view_points[1].AddArray({1.0, 2.0, 1.2}, ArrayPlane{});
  EXPECT_TRUE(source.HeardInPlanesAlone());
  source.view_points[0].AddArray({3.0, 2.0, 1.2}, std::nullopt);
  EXPECT_FALSE(source.HeardInPlanesAlone());
}

TEST(RegisteredSource, IsExplainedFromTheViewPointsWhoseArrayIsKnown) {
  RegisteredSource source;
  source.found.position_in_map_m = {4.0, 0.0, 1.0};
  EXPECT_EQ(source.ExplainedBy({8.0, 0.0, 1.0}).direct, 0.0);
  for (const double y_m : {0.0, 0.3, -0.2, 4.0, -4.0}) {
    source.view_points.emplace_back().AddArray({0.0, y_m, 1.0}, std::nullopt);
  }
  source.view_points.resize(8);
  const Explained behind = source.ExplainedBy({8.0, 0.0, 1.0});
  EXPECT_DOUBLE_EQ(behind.direct, 3.0 / 5.0);
  EXPECT_EQ(behind.mirrored, 0.0);
  // A surface across, seen from two of them, and what stands 2 m before it.
  source.view_points[0].surface_normal_sum_in_map = {-2.0, 0.0, 0.0};
  source.view_points[3].surface_normal_sum_in_map = {-1.0, 0.0, 0.0};
  const Explained before = source.ExplainedBy({2.0, -2.0, 1.0});
  EXPECT_DOUBLE_EQ(before.direct, 1.0 / 5.0);  // in one row from y = -4 m
  EXPECT_DOUBLE_EQ(before.mirrored,
                   1.0 / 5.0);  // from y = 4 m the way by the place is the shortest
}

}  // namespace
}  // namespace soundmap::sound_map
