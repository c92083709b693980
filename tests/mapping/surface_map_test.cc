#include "mapping/surface_map.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace soundmap::mapping {
namespace {

std::vector<Eigen::Vector3f> RandomPoints(int count, float size_m, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> coordinate(-size_m, size_m);
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < count; ++i) {
    points.emplace_back(coordinate(random), coordinate(random), coordinate(random));
  }
  return points;
}

TEST(SurfaceMap, NearestEqualsTheSearchOfAll) {
  SurfaceMap map(0.2);
  map.Insert(RandomPoints(600, 1.0f, 1));
  int none = 0;
  for (const double max_distance_m : {0.05, 0.15, 0.2, 0.5, 1.0}) {
    for (const Eigen::Vector3f& point : RandomPoints(2000, 1.3f, 2)) {
      const Surfel* expected = nullptr;
      float squared_m2 = static_cast<float>(max_distance_m * max_distance_m);
      for (const Surfel& surfel : map.surfels()) {
        if ((surfel.mean - point).squaredNorm() >= squared_m2) continue;
        expected = &surfel;
        squared_m2 = (surfel.mean - point).squaredNorm();
      }
      ASSERT_EQ(map.Nearest(point, max_distance_m), expected) << point.transpose();
      none += expected == nullptr;
    }
  }
  EXPECT_GT(none, 100);
  EXPECT_LT(none, 9000);
}

TEST(SurfaceMap, ASurfelIsTheMeanOfItsPoints) {
  SurfaceMap map(1.0);
  map.Insert(std::vector<Eigen::Vector3f>{{0.1f, 0.2f, 0.3f}, {0.3f, 0.4f, 0.5f}, {1.5f, 0, 0}});
  ASSERT_EQ(map.size(), 2u);
  const Surfel* surfel = map.At({0.9f, 0.9f, 0.9f});
  ASSERT_NE(surfel, nullptr);
  EXPECT_EQ(surfel->points, 2u);
  EXPECT_TRUE(surfel->mean.isApprox(Eigen::Vector3f(0.2f, 0.3f, 0.4f), 1e-6f));
  EXPECT_EQ(map.At({-0.1f, 0.1f, 0.1f}), nullptr);
}

TEST(SurfaceMap, PlanesFollowTheWallsAndDoNotCutTheCorner) {
  // Two walls that meet at right angles at x = 0, y = 0, turned by 0.3 rad about z, with noise.
  std::mt19937 random(3);
  std::uniform_real_distribution<float> along(0.0f, 3.0f);
  std::normal_distribution<float> noise(0.0f, 0.01f);
  const Eigen::Matrix3f turn = Eigen::AngleAxisf(0.3f, Eigen::Vector3f::UnitZ()).toRotationMatrix();
  SurfaceMap map(0.2);
  for (int i = 0; i < 60000; ++i) {
    map.Insert(std::vector<Eigen::Vector3f>{
        turn * Eigen::Vector3f(noise(random), along(random), along(random)),
        turn * Eigen::Vector3f(along(random), noise(random), along(random))});
  }
  map.FitPlanes();
  const Surfel* first = map.Nearest(turn * Eigen::Vector3f(0, 1.5f, 1.5f), 0.2);
  const Surfel* second = map.Nearest(turn * Eigen::Vector3f(1.5f, 0, 1.5f), 0.2);
  ASSERT_TRUE(first && first->has_plane() && second && second->has_plane());
  EXPECT_NEAR(std::abs(first->normal.dot(turn.col(0))), 1.0f, 1e-3f);
  EXPECT_NEAR(std::abs(second->normal.dot(turn.col(1))), 1.0f, 1e-3f);
  EXPECT_NEAR(first->normal.dot(turn * Eigen::Vector3f(0, 1.5f, 1.5f)), first->offset_m, 2e-3f);
  EXPECT_NEAR(second->normal.dot(turn * Eigen::Vector3f(1.5f, 0, 1.5f)), second->offset_m, 2e-3f);
  EXPECT_NEAR(first->normal.norm(), 1.0f, 1e-5f);
  // Along the edge a plane may follow one wall, but none cuts the corner.
  int without_plane = 0;
  for (const Surfel& surfel : map.surfels()) {
    without_plane += !surfel.has_plane();
    if (!surfel.has_plane()) continue;
    EXPECT_GT(std::max(std::abs(surfel.normal.dot(turn.col(0))),
                       std::abs(surfel.normal.dot(turn.col(1)))),
              0.9f)
        << surfel.mean.transpose();
  }
  EXPECT_GT(without_plane, 5);
}

TEST(SurfaceMap, ALineIsNoPlane) {
  SurfaceMap map(0.2);
  for (float x = 0; x < 3; x += 0.01f) map.Insert(std::vector<Eigen::Vector3f>{{x, 0.1f, 0.1f}});
  map.FitPlanes();
  for (const Surfel& surfel : map.surfels()) EXPECT_FALSE(surfel.has_plane());
}

TEST(SurfaceMap, LeavesOutWhatIsNotInTheMap) {
  SurfaceMap map(0.2);
  const float nan = std::nanf("");
  const float infinity = std::numeric_limits<float>::infinity();
  map.Insert(
      std::vector<Eigen::Vector3f>{{nan, 0, 0}, {0, infinity, 0}, {0, 0, -infinity}, {1e9f, 0, 0}});
  map.FitPlanes();
  EXPECT_EQ(map.size(), 0u);
  EXPECT_EQ(map.Nearest({0, 0, 0}, 1.0), nullptr);
  EXPECT_EQ(map.Nearest({nan, 0, 0}, 1.0), nullptr);
  EXPECT_EQ(map.At({0, infinity, 0}), nullptr);
}

}  // namespace
}  // namespace soundmap::mapping
