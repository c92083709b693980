#include "ray_casting/range_index.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "geometry/angles.h"
#include "geometry/directions.h"
#include "geometry/voxel_key.h"

namespace soundmap::ray_casting {
namespace {

using geometry::RadFromDeg;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::Ne;

Eigen::Vector3d RandomDirection(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  return Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
}

// Section V as written, but with v_L from O_a to M_j.
std::int32_t BruteForce(const std::vector<Eigen::Vector3f>& points, const Eigen::Vector3d& origin,
                        double max_angle_rad, const Eigen::Vector3d& v_a) {
  double least = std::numeric_limits<double>::infinity();
  std::int32_t best = kNoPoint;
  for (std::size_t j = 0; j < points.size(); ++j) {
    const double x = points[j].x() - origin.x();
    const double y = points[j].y() - origin.y();
    const double z = points[j].z() - origin.z();
    const double range_m = std::sqrt(x * x + y * y + z * z);
    if (!std::isfinite(range_m) || range_m == 0.0) continue;
    const double cost =
        1.0 - (x / range_m * v_a.x() + y / range_m * v_a.y() + z / range_m * v_a.z());
    if (cost < least && cost < 1.0 - std::cos(max_angle_rad)) {
      least = cost;
      best = static_cast<std::int32_t>(j);
    }
  }
  return best;
}

void ExpectAsBruteForce(const std::vector<Eigen::Vector3f>& points, const Eigen::Vector3d& origin,
                        double max_angle_deg, const std::vector<Eigen::Vector3d>& directions) {
  const double max_angle_rad = RadFromDeg(max_angle_deg);
  const Eigen::AngleAxisd askew(RadFromDeg(70.0), Eigen::Vector3d(0.3, -0.5, 0.8).normalized());
  for (const Eigen::AngleAxisd& turn : {Eigen::AngleAxisd::Identity(), askew}) {
    const Eigen::Isometry3d base_from_array = Eigen::Translation3d(origin) * turn;
    std::vector<Eigen::Vector3d> direction_in_array;
    std::vector<std::int32_t> expected;
    for (const Eigen::Vector3d& direction : directions) {
      direction_in_array.push_back(turn.inverse() * direction);
      expected.push_back(BruteForce(points, origin, max_angle_rad,
                                    base_from_array.linear() * direction_in_array.back()));
    }
    EXPECT_THAT(expected, Contains(Ne(kNoPoint)));
    const LookUpDirections look_up(geometry::DirectionGrid(direction_in_array, 0.02),
                                   max_angle_rad);
    for (const Kernels& kernels : AllKernels()) {
      RangeIndex index(kernels);
      index.Make(points, base_from_array);
      ASSERT_EQ(index.Nearest(look_up), expected) << kernels.name << ", turned by " << turn.angle();
    }
  }
}

// Seen from the origin, within 3 degrees.
std::vector<std::int32_t> Nearest(const std::vector<Eigen::Vector3f>& points,
                                  const std::vector<Eigen::Vector3d>& directions) {
  const LookUpDirections look_up(geometry::DirectionGrid(directions, 0.02), RadFromDeg(3.0));
  RangeIndex index;
  index.Make(points, Eigen::Isometry3d::Identity());
  return index.Nearest(look_up);
}

std::vector<Eigen::Vector3d> Directions(std::mt19937_64& random, int count) {
  std::vector<Eigen::Vector3d> directions = {Eigen::Vector3d::UnitX(),  Eigen::Vector3d::UnitY(),
                                             Eigen::Vector3d::UnitZ(),  -Eigen::Vector3d::UnitX(),
                                             -Eigen::Vector3d::UnitY(), -Eigen::Vector3d::UnitZ()};
  while (static_cast<int>(directions.size()) < count) directions.push_back(RandomDirection(random));
  return directions;
}

TEST(RangeIndex, FindsWhatBruteForceFindsInARandomCloud) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<float> uniform(-8.0f, 8.0f);
  for (const int count : {1, 10, 300, 5000}) {
    std::vector<Eigen::Vector3f> points;
    for (int i = 0; i < count; ++i) {
      points.emplace_back(uniform(random), uniform(random), uniform(random));
    }
    const Eigen::Vector3d origin(0.3, -0.2, 0.9);
    auto directions = Directions(random, 500);
    for (int i = 0; i < count; i += 1 + count / 50) {
      directions.push_back(
          (points[i].cast<double>() - origin + 0.02 * RandomDirection(random)).normalized());
    }
    for (const double max_angle_deg : {0.3, 3.0, 20.0}) {
      ExpectAsBruteForce(points, origin, max_angle_deg, directions);
    }
  }
}

TEST(RangeIndex, FindsWhatBruteForceFindsAmongRingsAndClusters) {
  std::mt19937_64 random(2);
  std::normal_distribution<float> normal(0.0f, 0.02f);
  std::vector<Eigen::Vector3f> points;
  for (int ring = -20; ring < 20; ++ring) {
    for (int beam = 0; beam < 180; ++beam) {
      points.push_back(
          (3.0 * geometry::DirectionFromAngles(RadFromDeg(2.0 * beam), RadFromDeg(2.3 * ring)))
              .cast<float>());
    }
  }
  const Eigen::Vector3f heart(1.0f, 2.0f, 1.5f);
  for (int i = 0; i < 2000; ++i) {
    points.push_back(heart + Eigen::Vector3f(normal(random), normal(random), normal(random)));
  }
  auto directions = Directions(random, 1500);
  const Eigen::Vector3d origin(0.1, 0.0, 0.8);
  for (int i = 0; i < 500; ++i) {
    directions.push_back(
        (heart.cast<double>() - origin + 0.05 * RandomDirection(random)).normalized());
  }
  ExpectAsBruteForce(points, origin, 3.0, directions);
}

// Where cells by elevation and azimuth come to an end.
TEST(RangeIndex, FindsWhatBruteForceFindsAroundTheAxes) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> range_m(0.2, 30.0);
  for (const int count : {20, 400, 3000}) {
    std::vector<Eigen::Vector3f> points;
    std::vector<Eigen::Vector3d> directions;
    const Eigen::Vector3d origin(0.2, -0.1, 1.1);
    for (int i = 0; i < count; ++i) {
      Eigen::Vector3d axis = Eigen::Vector3d::Zero();
      axis[i % 3] = i % 2 == 0 ? 1.0 : -1.0;
      const auto near_axis = [&](double spread) {
        return (axis + spread * RandomDirection(random)).normalized();
      };
      points.push_back((origin + range_m(random) * near_axis(0.1)).cast<float>());
      if (i < 600) directions.push_back(near_axis(i % 5 == 0 ? 1e-3 : 0.12));
    }
    for (const double max_angle_deg : {1.0, 8.0, 45.0}) {
      ExpectAsBruteForce(points, origin, max_angle_deg, directions);
    }
  }
}

TEST(RangeIndex, OfEqualPointsTheFirstWins) {
  const Eigen::Vector3f point(2.0f, 1.0f, 0.5f);
  std::vector<Eigen::Vector3f> points(50, Eigen::Vector3f(-1.0f, -1.0f, 0.0f));
  for (const int i : {7, 8, 30, 49}) points[i] = point;
  EXPECT_THAT(Nearest(points, {point.cast<double>().normalized()}), ElementsAre(7));
}

// The differences are lost where a float of 0.01 is.
TEST(RangeIndex, TellsDirectionsApartThatFloatsCannot) {
  const std::vector<Eigen::Vector3f> points = {{1.0f, 0.0f, -0.01f}, {1.0f, 0.0f, 0.01f}};
  EXPECT_THAT(Nearest(points, {{1.0, 0.0, -1e-11}, {1.0, 0.0, 1e-11}, {1.0, 0.0, 0.0}}),
              ElementsAre(0, 1, 0));
}

// Two points in one direction, one behind the other: only the order counts, not the range.
TEST(RangeIndex, RangeIsNoReasonToPreferAPoint) {
  const std::vector<Eigen::Vector3f> points = {{8.0f, 0.0f, 0.0f}, {2.0f, 0.0f, 0.0f}};
  EXPECT_THAT(Nearest(points, {Eigen::Vector3d::UnitX()}), ElementsAre(0));
}

// The end of each ray in the plain words of Eigen and KeyFromPoint(), to the last bit.
TEST(RangeIndex, RaysEndInTheVoxelsOfTheirEndPoints) {
  std::mt19937_64 random(4);
  std::uniform_real_distribution<float> uniform(-8.0f, 8.0f);
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 2000; ++i) {
    points.emplace_back(uniform(random), uniform(random), uniform(random));
  }
  const auto any_pose = [&](double reach_m) {
    return Eigen::Isometry3d(Eigen::Translation3d(reach_m * RandomDirection(random)) *
                             Eigen::AngleAxisd(uniform(random), RandomDirection(random)));
  };
  for (int i = 0; i < 300; ++i) points.push_back(0.05f * points[i].array().round().matrix());
  const LookUpDirections look_up(geometry::DirectionGrid(Directions(random, 3001), 0.02), 0.2);
  // Within the octree, at its edge, and on the lattice of the voxels.
  for (const Eigen::Isometry3d& map_from_array :
       {any_pose(20.0), any_pose(1638.4), Eigen::Isometry3d::Identity()}) {
    const Eigen::Isometry3d base_from_array = any_pose(1.0);
    int inside = 0;
    for (const Kernels& kernels : AllKernels()) {
      RangeIndex index(kernels);
      index.Make(points, base_from_array);
      const auto nearest = index.Nearest(look_up);
      const auto keys = index.EndKeys(look_up, nearest, map_from_array, 6.0, 0.05);
      for (int i = 0; i < look_up.size(); ++i) {
        std::uint64_t expected = kNoKey;
        if (nearest[i] != kNoPoint) {
          const double range_m =
              (points[nearest[i]].cast<double>() - base_from_array.translation()).norm();
          const auto key =
              geometry::KeyFromPoint(map_from_array * (range_m * look_up.grid()[i]), 0.05);
          if (key && range_m <= 6.0) {
            ++inside;
            expected = std::uint64_t{key->x} << 32 | std::uint64_t{key->y} << 16 | key->z;
          }
        }
        ASSERT_EQ(keys[i], expected) << kernels.name << ", direction " << i;
      }
    }
    EXPECT_GT(inside, 100);
  }
}

TEST(RangeIndex, NothingBeyondTheAngle) {
  EXPECT_THAT(Nearest({{1.0f, 0.0f, 0.0f}}, {geometry::DirectionFromAngles(RadFromDeg(2.99), 0.0),
                                             geometry::DirectionFromAngles(RadFromDeg(3.01), 0.0),
                                             -Eigen::Vector3d::UnitX()}),
              ElementsAre(0, kNoPoint, kNoPoint));
}

TEST(RangeIndex, HostilePointsAreNeverFound) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  constexpr float kInf = std::numeric_limits<float>::infinity();
  const std::vector<Eigen::Vector3f> points = {{kNan, 0, 0}, {kInf, 0, 0},  {0, -kInf, kNan},
                                               {0, 0, 0},    {3e38f, 0, 0}, {1e-30f, 0, 0}};
  EXPECT_THAT(Nearest(points, {Eigen::Vector3d::UnitX(), -Eigen::Vector3d::UnitY(),
                               Eigen::Vector3d(kNan, 0, 0)}),
              ElementsAre(4, kNoPoint, kNoPoint));
  EXPECT_THAT(Nearest({}, {Eigen::Vector3d::UnitX()}), ElementsAre(kNoPoint));
}

}  // namespace
}  // namespace soundmap::ray_casting
