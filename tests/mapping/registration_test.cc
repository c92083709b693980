#include "mapping/registration.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "geometry/angles.h"
#include "mapping/point_thinning.h"
#include "tests/mapping/box_room.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;

SurfaceMap MapOf(const BoxRoom& room, const DriveModel& model) {
  std::mt19937 random(1);
  SurfaceMap map(0.2);
  for (double time_s = 0.0; time_s < model.lap_s; time_s += 4.0) {
    const Pose2 map_from_base = model.MapFromBase(time_s);
    for (Eigen::Vector3f& point : ScanInBase(room, model, map_from_base, random)) {
      map.Insert(
          std::vector{(map_from_base.ToIsometry() * point.cast<double>()).cast<float>().eval()});
    }
  }
  map.FitPlanes();
  return map;
}

TEST(Registration, FindsTheTruePoseFromPerturbedStarts) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const DriveModel model{.range_noise_m = 0.01};
  const SurfaceMap map = MapOf(room, model);
  std::mt19937 random(2);
  std::uniform_real_distribution<double> shift_m(-0.3, 0.3);
  std::uniform_real_distribution<double> turn_rad(-0.1, 0.1);
  for (int i = 0; i < 20; ++i) {
    const Pose2 truth = model.MapFromBase(1.7 * i);
    const auto points = ScanInBase(room, model, truth, random);
    const Pose2 start{truth.x_m + shift_m(random), truth.y_m + shift_m(random),
                      truth.yaw_rad + turn_rad(random)};
    const Registration found = Register(
        points, map, start, {.start_distance_m = 0.5, .prior_std_m = 1.0, .prior_std_rad = 1.0});
    EXPECT_NEAR(found.map_from_base.x_m, truth.x_m, 0.005) << i;
    EXPECT_NEAR(found.map_from_base.y_m, truth.y_m, 0.005) << i;
    EXPECT_NEAR(geometry::NormalizeAngle(found.map_from_base.yaw_rad - truth.yaw_rad), 0.0, 0.0015)
        << i;
    EXPECT_GT(found.fit(), 0.9);
    EXPECT_GT(found.constraints, 500);
    EXPECT_GT(found.overlap, 0.9);
    EXPECT_LT(found.mean_residual_m, 0.015);
  }
}

TEST(Registration, APersonInTheScanDoesNotPull) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const DriveModel model;
  const SurfaceMap map = MapOf(room, model);
  std::mt19937 random(2);
  const Pose2 truth = model.MapFromBase(3.0);
  auto points = ScanInBase(room, model, truth, random);
  // A fifth of the view is now 0.1 m nearer than the walls: within reach of their surfels.
  for (std::size_t i = 0; i < points.size() / 5; ++i) points[i] *= 1.0f - 0.1f / points[i].norm();
  const Registration found = Register(points, map, truth, {});
  EXPECT_NEAR(found.map_from_base.x_m, truth.x_m, 0.01);
  EXPECT_NEAR(found.map_from_base.y_m, truth.y_m, 0.01);
}

TEST(Registration, InACorridorTheStartDecidesAlongIt) {
  // Two parallel walls without ends: x cannot be seen.
  SurfaceMap map(0.2);
  std::vector<Eigen::Vector3f> points;
  for (float x = -5.0f; x < 5.0f; x += 0.05f) {
    for (float z = 0.1f; z < 2.0f; z += 0.05f) {
      points.emplace_back(x, -1.03f, z);
      points.emplace_back(x, 1.07f, z);
    }
  }
  map.Insert(points);
  map.FitPlanes();
  const Registration found = Register(points, map, {0.1, 0.1, 0.05}, {});
  EXPECT_NEAR(found.map_from_base.x_m, 0.1, 0.01);
  EXPECT_NEAR(found.map_from_base.y_m, 0.0, 0.005);
  EXPECT_NEAR(found.map_from_base.yaw_rad, 0.0, 0.001);
}

TEST(Registration, WithoutAMapThePoseStays) {
  const SurfaceMap map(0.2);
  const Pose2 start{1.0, 2.0, 3.0};
  const std::vector<Eigen::Vector3f> points = {{1, 1, 1}, {std::nanf(""), 0, 0}};
  for (const auto& scan : {points, std::vector<Eigen::Vector3f>{}}) {
    const Registration found = Register(scan, map, start, {});
    EXPECT_EQ(found.map_from_base, start);
    EXPECT_EQ(found.inliers, 0);
    EXPECT_EQ(found.overlap, 0.0);
  }
}

TEST(FirstPointPerCube, KeepsOnePointOfEachCubeInOrder) {
  const float nan = std::nanf("");
  const std::vector<Eigen::Vector3f> points = {{0.01f, 0, 0}, {nan, 0, 0},      {0.06f, 0, 0},
                                               {0.02f, 0, 0}, {-0.01f, 0, 0},   {1e9f, 0, 0},
                                               {0.07f, 0, 0}, {0.01f, 0, 0.06f}};
  EXPECT_EQ(FirstPointPerCube(points, 0.05), (std::vector<std::uint32_t>{0, 2, 4, 7}));
}

}  // namespace
}  // namespace soundmap::mapping
