#include "sources/simulation/random_scene.h"

#include <gtest/gtest.h>

#include <Eigen/SVD>
#include <cmath>
#include <numbers>

#include "sources/simulation/free_floor.h"
#include "sources/simulation/scene.h"

namespace soundmap::simulation {
namespace {

Scene Parse(std::uint64_t seed) {
  const auto text = RandomScene(seed);
  EXPECT_TRUE(text.ok()) << text.status();
  const auto scene = ParseScene(*text, "random", "");
  EXPECT_TRUE(scene.ok()) << scene.status();
  return *scene;
}

bool IsPlanar(const std::vector<Eigen::Vector3d>& points) {
  Eigen::MatrixXd offsets(3, points.size());
  for (std::size_t i = 0; i < points.size(); ++i) offsets.col(i) = points[i] - points[0];
  return Eigen::JacobiSVD<Eigen::MatrixXd>(offsets).rank() < 3;
}

TEST(RandomScene, IsAsVariedAsPromisedAndCanBeDriven) {
  for (std::uint64_t seed = 500; seed < 530; ++seed) {
    SCOPED_TRACE(seed);
    const Scene scene = Parse(seed);
    EXPECT_GE(scene.room_m.head<2>().minCoeff(), 4.0);
    EXPECT_LE(scene.room_m.head<2>().maxCoeff(), 20.0);
    EXPECT_GE(scene.reverberation.rt60_s, 0.2);
    EXPECT_LE(scene.reverberation.rt60_s, 0.9);
    EXPECT_GE(scene.sources.size(), 1u);
    EXPECT_LE(scene.sources.size(), 8u);
    for (std::size_t i = 0; i < scene.sources.size(); ++i) {
      EXPECT_LE(scene.sources[i].level, 1.0);
      EXPECT_GE(scene.sources[i].level, 0.25);  // 12 dB
      for (std::size_t k = 0; k < i; ++k) {
        EXPECT_GE((scene.sources[i].position_m - scene.sources[k].position_m).norm(), 1.2);
      }
    }
    constexpr std::size_t kCounts[] = {8, 16, 32};
    EXPECT_EQ(scene.array.microphone_in_array_m.size(), kCounts[seed / 3 % 3]);
    EXPECT_EQ(IsPlanar(scene.array.microphone_in_array_m), seed % 3 == 0);
  }
}

TEST(RandomScene, IsDecidedByTheSeed) {
  EXPECT_EQ(*RandomScene(7), *RandomScene(7));
  EXPECT_NE(*RandomScene(7), *RandomScene(16));
}

// A wall with one gap between the two places.
TEST(FreeFloor, LeadsAroundWhatStandsThere) {
  const std::vector<Box> wall = {{{4.9, 0.0, 0.0}, {5.1, 7.0, 1.0}}};
  const FreeFloor floor({10.0, 10.0, 3.0}, wall, 0.5);
  const Eigen::Vector2d from(2.0, 2.0), to(8.0, 2.0);
  const auto path = floor.ShortestPath(from, to);
  ASSERT_GE(path.size(), 3u);
  EXPECT_EQ(path.front(), from);
  EXPECT_EQ(path.back(), to);
  double length_m = 0.0;
  for (std::size_t i = 1; i < path.size(); ++i) {
    length_m += (path[i] - path[i - 1]).norm();
    for (double share = 0.0; share <= 1.0; share += 0.01) {
      const Eigen::Vector2d point = path[i - 1] + share * (path[i] - path[i - 1]);
      const Eigen::Vector2d outside =
          Eigen::Vector2d(std::abs(point.x() - 5.0) - 0.1, point.y() - 7.0).cwiseMax(0.0);
      EXPECT_GE(outside.norm(), 0.4) << point.transpose();  // the radius, less a cell
    }
  }
  // Two tangents to circles around the wall's corners, their arcs, and the wall's width between.
  const double tangent_m = std::sqrt(2.9 * 2.9 + 5.0 * 5.0 - 0.25);
  const double arc_m =
      0.5 * (std::numbers::pi / 2.0 - std::atan2(2.9, 5.0) + std::asin(0.5 / 5.78));
  const double shortest_m = 2.0 * tangent_m + 2.0 * arc_m + 0.2;
  EXPECT_NEAR(length_m, shortest_m, 0.5);
  EXPECT_TRUE(floor.ShortestPath(from, {5.0, 3.0}).empty());
  EXPECT_TRUE(floor.ShortestPath({-1.0, 3.0}, to).empty());
}

TEST(FreeFloor, OfTwoPartsOnlyTheLargerCounts) {
  const std::vector<Box> wall = {{{2.9, 0.0, 0.0}, {3.1, 6.0, 1.0}}};
  const FreeFloor floor({10.0, 6.0, 3.0}, wall, 0.4);
  EXPECT_TRUE(floor.IsFree({7.0, 3.0}));
  EXPECT_FALSE(floor.IsFree({1.5, 3.0}));
  EXPECT_NEAR(floor.free_share(), (6.9 - 0.8) * (6.0 - 0.8) / 60.0, 0.03);
}

}  // namespace
}  // namespace soundmap::simulation
