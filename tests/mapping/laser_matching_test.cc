#include "mapping/laser_matching.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <random>

#include "geometry/angles.h"
#include "mapping/laser_search.h"
#include "tests/mapping/laser_world.h"

namespace soundmap::mapping {
namespace {

using Eigen::Vector2f;
using geometry::Pose2;

std::vector<Vector2f> PointsFrom(const LaserWorld& world, const Pose2& pose, int beams,
                                 double max_range_m, double noise_m, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0.0, noise_m);
  std::vector<Vector2f> points;
  for (int beam = 0; beam < beams; ++beam) {
    const double angle = 2.0 * geometry::kPi * beam / beams;
    const double range = world.Range({pose.x_m, pose.y_m}, pose.yaw_rad + angle);
    if (!(range <= max_range_m)) continue;
    const double measured = range + (noise_m > 0.0 ? noise(random) : 0.0);
    points.emplace_back(static_cast<float>(measured * std::cos(angle)),
                        static_cast<float>(measured * std::sin(angle)));
  }
  return points;
}

std::vector<Vector2f> InMap(const std::vector<Vector2f>& points, const Pose2& pose) {
  std::vector<Vector2f> in_map;
  for (const Vector2f& p : points) {
    in_map.emplace_back(static_cast<float>(pose.x_m + std::cos(pose.yaw_rad) * p.x() -
                                           std::sin(pose.yaw_rad) * p.y()),
                        static_cast<float>(pose.y_m + std::sin(pose.yaw_rad) * p.x() +
                                           std::cos(pose.yaw_rad) * p.y()));
  }
  return in_map;
}

LineMap MapOf(const LaserWorld& world, const std::vector<Pose2>& places,
              double max_range_m = 30.0) {
  LineMap map(0.2);
  for (std::size_t i = 0; i < places.size(); ++i) {
    map.Insert(InMap(PointsFrom(world, places[i], 720, max_range_m, 0.01, 100 + i), places[i]));
  }
  map.FitLines();
  return map;
}

TEST(LineMap, FitsTheWallThatThePointsLieOn) {
  LineMap map(0.2);
  std::vector<Vector2f> points;
  for (int i = 0; i < 200; ++i) {  // y = 0.5 x + 1, in steps of 1 cm along x
    points.emplace_back(0.01f * i, 0.005f * i + 1.0f);
  }
  map.Insert(points);
  map.FitLines();
  const LinePiece* piece = map.At({1.0f, 1.5f});
  ASSERT_NE(piece, nullptr);
  ASSERT_TRUE(piece->has_line());
  const Vector2f normal = Vector2f(-0.5f, 1.0f).normalized();
  EXPECT_NEAR(std::abs(piece->normal.dot(normal)), 1.0, 1e-5);
  EXPECT_NEAR(piece->offset_m * piece->normal.dot(normal), 1.0f / std::sqrt(1.25f), 1e-4);
}

TEST(LineMap, ABlobIsNoLineAndHostilePointsAreLeftOut) {
  LineMap map(0.2);
  std::mt19937 random(1);
  std::uniform_real_distribution<float> in_square(0.0f, 0.2f);
  std::vector<Vector2f> points;
  for (int i = 0; i < 100; ++i) points.emplace_back(in_square(random), in_square(random));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  points.insert(points.end(), {{nan, 0}, {0, std::numeric_limits<float>::infinity()}, {1e30f, 0}});
  map.Insert(points);
  map.FitLines();
  ASSERT_EQ(map.size(), 1u);
  EXPECT_FALSE(map.pieces()[0].has_line());
  EXPECT_EQ(map.pieces()[0].points, 100.0f);
  EXPECT_EQ(map.Nearest({nan, nan}, 1.0f), nullptr);
  EXPECT_EQ(map.At({1e30f, 0.0f}), nullptr);
}

TEST(LineMap, NearestIsWhatBruteForceFinds) {
  const LineMap map = MapOf(FurnishedHall(), {{2, 2, 0}, {6, 5, 1}});
  std::mt19937 random(2);
  std::uniform_real_distribution<float> x(-1.0f, 10.0f), y(-1.0f, 8.0f);
  int found = 0;
  for (int i = 0; i < 500; ++i) {
    const Vector2f point(x(random), y(random));
    float nearest_m = 0.5f;
    for (const LinePiece& piece : map.pieces()) {
      nearest_m = std::min(nearest_m, (piece.mean - point).norm());
    }
    const LinePiece* piece = map.Nearest(point, 0.5f);
    EXPECT_EQ(piece != nullptr, nearest_m < 0.5f);
    if (!piece) continue;
    ++found;
    EXPECT_FLOAT_EQ((piece->mean - point).norm(), nearest_m);
  }
  EXPECT_GT(found, 100);
}

TEST(MatchToLines, FindsThePoseFromPerturbedStarts) {
  const LaserWorld world = FurnishedHall();
  const LineMap map = MapOf(world, {{2, 2, 0}, {6, 5, 1}, {3, 5, 2}, {6.5, 2.5, 3}});
  std::mt19937 random(3);
  std::uniform_real_distribution<double> off_m(-0.2, 0.2), off_rad(-0.1, 0.1);
  for (int i = 0; i < 50; ++i) {
    const Pose2 truth{3.0 + 0.05 * i, 2.2, 0.1 * i};
    const std::vector<Vector2f> points = PointsFrom(world, truth, 360, 30.0, 0.01, 200 + i);
    const Pose2 start{truth.x_m + off_m(random), truth.y_m + off_m(random),
                      truth.yaw_rad + off_rad(random)};
    const LaserMatch match = MatchToLines(
        points, map, start, {.start_distance_m = 0.4, .prior_std_m = 0.3, .prior_std_rad = 0.2});
    EXPECT_LT(std::hypot(match.map_from_base.x_m - truth.x_m, match.map_from_base.y_m - truth.y_m),
              0.01);
    EXPECT_LT(std::abs(geometry::NormalizeAngle(match.map_from_base.yaw_rad - truth.yaw_rad)),
              0.003);
    EXPECT_GT(match.fit(), 0.9);
    EXPECT_GT(match.overlap(), 0.9);
  }
}

TEST(MatchToLines, AlongABareCorridorTheStartHolds) {
  LaserWorld world;
  world.AddWall({-50, -1}, {50, -1});
  world.AddWall({-50, 1}, {50, 1});
  const LineMap map = MapOf(world, {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}, 8.0);
  const Pose2 truth{1.5, 0.0, 0.0};
  const Pose2 start{1.62, 0.1, 0.05};
  const LaserMatch match =
      MatchToLines(PointsFrom(world, truth, 360, 5.0, 0.01, 4), map, start,
                   {.start_distance_m = 0.4, .prior_std_m = 0.05, .prior_std_rad = 0.05});
  EXPECT_NEAR(match.map_from_base.x_m, start.x_m, 0.03);
  EXPECT_NEAR(match.map_from_base.y_m, 0.0, 0.01);
  EXPECT_NEAR(match.map_from_base.yaw_rad, 0.0, 0.005);
  // What is measured is across the corridor, and says so.
  EXPECT_GT(match.information(1, 1), 100.0 * match.information(0, 0));
}

TEST(MatchToLines, NothingToMatchStaysAtTheStart) {
  const LineMap empty(0.2);
  const Pose2 start{1, 2, 3};
  const LaserMatch match = MatchToLines({}, empty, start, {});
  EXPECT_EQ(match.map_from_base, start);
  EXPECT_EQ(match.inliers, 0);
  EXPECT_EQ(match.fit(), 0.0);
  EXPECT_TRUE(match.information.isZero());
}

// Independent of the pyramid: every pose of the window, one by one.
TEST(LaserSearch, FindsWhatTryingEveryPoseFinds) {
  const LaserWorld world = FurnishedHall();
  const Pose2 truth{3.3, 2.1, 0.4};
  const std::vector<Vector2f> map =
      InMap(PointsFrom(world, {5, 4.5, 0}, 720, 30, 0.0, 5), {5, 4.5, 0});
  const std::vector<Vector2f> points = PointsFrom(world, truth, 90, 30, 0.0, 6);
  const LaserSearch search(map, 0.1);
  const Pose2 start{truth.x_m + 0.83, truth.y_m - 0.64, truth.yaw_rad + 0.17};
  const auto found = search.Find(points, start, {.distance_m = 1.2, .angle_rad = 0.3}, 0.3);
  ASSERT_TRUE(found);
  EXPECT_LT(std::hypot(found->map_from_base.x_m - truth.x_m, found->map_from_base.y_m - truth.y_m),
            0.15);
  EXPECT_LT(std::abs(found->map_from_base.yaw_rad - truth.yaw_rad), 0.02);

  double best = 0.0;
  for (double x = -1.2; x <= 1.2; x += 0.1) {
    for (double y = -1.2; y <= 1.2; y += 0.1) {
      for (double yaw = -0.3; yaw <= 0.3; yaw += 0.02) {
        const Pose2 pose{start.x_m + x, start.y_m + y, start.yaw_rad + yaw};
        double score = 0.0;
        for (const Vector2f& point : InMap(points, pose)) {
          double squared = 1e9;
          for (const Vector2f& other : map) {
            squared = std::min<double>(squared, (point - other).squaredNorm());
          }
          score += std::exp(-0.5 * squared / 0.01);
        }
        best = std::max(best, score / static_cast<double>(points.size()));
      }
    }
  }
  EXPECT_NEAR(found->score, best, 0.1);
}

TEST(LaserSearch, TellsWhenTheAnswerIsNotTheOnlyOne) {
  LaserWorld corridor;
  corridor.AddWall({-50, -1}, {50, -1});
  corridor.AddWall({-50, 1}, {50, 1});
  const std::vector<Vector2f> map = InMap(PointsFrom(corridor, {0, 0, 0}, 1440, 20, 0.0, 7), {});
  const std::vector<Vector2f> points = PointsFrom(corridor, {0, 0, 0}, 180, 5, 0.0, 8);
  const auto found = LaserSearch(map, 0.1).Find(points, {0.5, 0.1, 0.0}, {}, 0.3);
  ASSERT_TRUE(found);
  EXPECT_FALSE(found->unique);
}

TEST(LaserSearch, NothingThereIsNotFound) {
  const std::vector<Vector2f> square = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  EXPECT_FALSE(LaserSearch({}, 0.1).Find(square, {}, {}, 0.1));
  EXPECT_FALSE(LaserSearch(square, 0.1).Find({}, {}, {}, 0.1));
  EXPECT_FALSE(LaserSearch(square, 0.1).Find(square, {100, 100, 0}, {}, 0.1));
  const std::vector<Vector2f> far_apart = {{0, 0}, {1e6f, 1e6f}};
  EXPECT_FALSE(LaserSearch(far_apart, 0.1).Find(square, {}, {}, 0.1));
}

}  // namespace
}  // namespace soundmap::mapping
