#include "sources/simulation/scanners.h"

#include <gtest/gtest.h>

#include <cmath>

#include "sources/simulation/random_streams.h"
#include "tests/simulation/scene_texts.h"

namespace soundmap::simulation {
namespace {

// A robot that drives around a box while a person walks by.
nlohmann::json DrivingScene() {
  auto scene = StandingScene();
  scene["furniture"] = {{{3.5, 3, 0}, {4.5, 4, 1}}};
  scene["people"] = {{{"way_points", {{1, 1}, {1, 6}}}, {"speed_mps", 1.5}}};
  scene["lidar"] = {{"swept", true}, {"range_noise_m", 0},           {"dropout_rate", 0},
                    {"rate_hz", 2},  {"position_m", {0.1, 0, 1.45}}, {"rpy_deg", {5, -8, 20}}};
  scene["path"] = {{"way_points", {{2.5, 2}, {5.5, 2}, {5.5, 5}, {2.5, 5}}}, {"speed_mps", 1.0}};
  return scene;
}

// Distance from a point to the nearest surface of room, furniture or people.
double ToSurface(const Scene& scene, const Eigen::Vector3d& point, double time_s) {
  const auto to_faces = [&](const Box& box) {
    const Eigen::Array3d below = (box.min_m - point).array(), above = (point - box.max_m).array();
    const Eigen::Array3d outside = below.max(above);
    const double out = outside.max(0.0).matrix().norm();
    return out > 0.0 ? out : -outside.maxCoeff();
  };
  double nearest_m = to_faces({Eigen::Vector3d::Zero(), scene.room_m});
  for (const Box& box : scene.furniture) nearest_m = std::min(nearest_m, to_faces(box));
  for (const Box& box : PeopleAt(scene.people, time_s))
    nearest_m = std::min(nearest_m, to_faces(box));
  return nearest_m;
}

TEST(Lidar, SweptPointsLieOnSurfacesAtTheirOwnTimesAndNotAtTheScans) {
  const Scene scene = Parse(DrivingScene());
  const auto trajectory = Trajectory::Create(scene.path, 1.0);
  const RayCaster rays(scene.room_m, scene.furniture);
  auto engine = MakeEngine(1, RandomStream::kLidar);
  double worst_m = 0.0, worst_if_instant_m = 0.0;
  for (double time_s : {1.0, 4.0, 9.5}) {
    const LidarScan scan = ScanLidar(scene, rays, *trajectory, time_s, engine);
    ASSERT_EQ(scan.point_in_lidar.size(), 40u * 300u);
    ASSERT_EQ(scan.time_offset_ns.size(), scan.point_in_lidar.size());
    EXPECT_EQ(scan.time_offset_ns.front(), 0u);
    EXPECT_NEAR(scan.time_offset_ns.back() * 1e-9, 0.5 * 299 / 300, 1e-6);
    for (std::size_t i = 0; i < scan.point_in_lidar.size(); i += 7) {
      const double own_s = time_s + scan.time_offset_ns[i] * 1e-9;
      const auto map_point = [&](double at_s) -> Eigen::Vector3d {
        return trajectory->At(at_s).map_from_base() * scene.lidar.base_from_lidar *
               scan.point_in_lidar[i].cast<double>();
      };
      worst_m = std::max(worst_m, ToSurface(scene, map_point(own_s), own_s));
      worst_if_instant_m =
          std::max(worst_if_instant_m, ToSurface(scene, map_point(time_s), time_s));
    }
  }
  EXPECT_LT(worst_m, 1e-5);
  EXPECT_GT(worst_if_instant_m, 0.1);
}

TEST(Lidar, InstantaneousScansHaveNoOffsetsAndAllPointsFitOnePose) {
  auto text = DrivingScene();
  text["lidar"]["swept"] = false;
  const Scene scene = Parse(text);
  const auto trajectory = Trajectory::Create(scene.path, 1.0);
  auto engine = MakeEngine(1, RandomStream::kLidar);
  const LidarScan scan =
      ScanLidar(scene, RayCaster(scene.room_m, scene.furniture), *trajectory, 4.0, engine);
  EXPECT_TRUE(scan.time_offset_ns.empty());
  for (const auto& point : scan.point_in_lidar) {
    const Eigen::Vector3d in_map =
        trajectory->At(4.0).map_from_base() * scene.lidar.base_from_lidar * point.cast<double>();
    ASSERT_LT(ToSurface(scene, in_map, 4.0), 1e-5);
  }
}

TEST(Lidar, DropsPointsAndAddsNoiseAsAsked) {
  auto text = DrivingScene();
  text["lidar"].update({{"swept", false}, {"range_noise_m", 0.03}, {"dropout_rate", 0.25}});
  const Scene scene = Parse(text);
  text["lidar"].update({{"range_noise_m", 0}, {"dropout_rate", 0}});
  const Scene exact_scene = Parse(text);
  const auto trajectory = Trajectory::Create(scene.path, 1.0);
  const RayCaster rays(scene.room_m, scene.furniture);
  auto engine = MakeEngine(1, RandomStream::kLidar);
  const LidarScan scan = ScanLidar(scene, rays, *trajectory, 4.0, engine);
  const LidarScan exact = ScanLidar(exact_scene, rays, *trajectory, 4.0, engine);
  EXPECT_NEAR(scan.point_in_lidar.size() / 12000.0, 0.75, 0.02);
  // Noise moves a point along its ray: pair each with the exact point of the same direction.
  double square = 0.0;
  std::size_t next = 0;
  for (const auto& point : scan.point_in_lidar) {
    while (exact.point_in_lidar[next].normalized().dot(point.normalized()) < 1.0f - 1e-6f) {
      ASSERT_LT(++next, exact.point_in_lidar.size());
    }
    square += std::pow(point.norm() - exact.point_in_lidar[next].norm(), 2);
  }
  EXPECT_NEAR(std::sqrt(square / scan.point_in_lidar.size()), 0.03, 0.002);
}

TEST(Lidar, NothingReturnsFromBeyondTheMaximumRange) {
  auto text = DrivingScene();
  text["lidar"].update({{"max_range_m", 2.0}});
  const Scene scene = Parse(text);
  auto engine = MakeEngine(1, RandomStream::kLidar);
  const auto trajectory = Trajectory::Create(scene.path, 1.0);
  const LidarScan scan =
      ScanLidar(scene, RayCaster(scene.room_m, scene.furniture), *trajectory, 4.0, engine);
  ASSERT_FALSE(scan.point_in_lidar.empty());
  ASSERT_LT(scan.point_in_lidar.size(), 12000u);
  for (const auto& point : scan.point_in_lidar) EXPECT_LE(point.norm(), 2.0f + 1e-5f);
}

TEST(Laser, ReadsTheRangeOfEachBeamWithItsNoiseBadBeamsAndDropouts) {
  auto text = StandingScene();
  text["path"]["standing_yaw_deg"] = 30;
  text["laser"] = {{"position_m", {0.2, 0.1, 0.3}}, {"beams", 541},
                   {"field_of_view_deg", 270},      {"range_noise_m", 0.01},
                   {"bad_beam_rate", 0.1},          {"dropout_rate", 0.05}};
  const Scene scene = Parse(text);
  const auto trajectory = Trajectory::Create(scene.path, 1.0);
  const RayCaster rays(scene.room_m, scene.furniture);
  auto engine = MakeEngine(1, RandomStream::kLaser);
  const double yaw_rad = 30 * M_PI / 180;
  const double x_m = 3 + 0.2 * std::cos(yaw_rad) - 0.1 * std::sin(yaw_rad);
  const double y_m = 3 + 0.2 * std::sin(yaw_rad) + 0.1 * std::cos(yaw_rad);
  int good = 0, lost = 0, total = 0;
  double square = 0.0;
  for (int scan = 0; scan < 50; ++scan) {
    const auto ranges_m = ScanLaser(scene, rays, *trajectory, 0.1 * scan, engine);
    ASSERT_EQ(ranges_m.size(), 541u);
    for (int beam = 0; beam < 541; ++beam) {
      const double angle_rad = yaw_rad + (-135.0 + 0.5 * beam) * M_PI / 180;
      const double to_x_m = ((std::cos(angle_rad) > 0 ? 8.0 : 0.0) - x_m) / std::cos(angle_rad);
      const double to_y_m = ((std::sin(angle_rad) > 0 ? 7.0 : 0.0) - y_m) / std::sin(angle_rad);
      const double error_m = ranges_m[beam] - std::min(to_x_m, to_y_m);
      ++total;
      if (std::isinf(ranges_m[beam])) {
        ++lost;
      } else if (std::abs(error_m) < 0.06) {
        ++good;
        square += error_m * error_m;
      }
    }
  }
  EXPECT_NEAR(static_cast<double>(lost) / total, 0.05 * 0.9, 0.006);
  EXPECT_NEAR(static_cast<double>(good) / total, 0.95 * 0.9, 0.015);
  EXPECT_NEAR(std::sqrt(square / good), 0.01, 0.0007);
}

TEST(Laser, SeesPeopleWalk) {
  auto text = StandingScene();
  text["people"] = {
      {{"way_points", {{6, 3}, {4, 3}}}, {"speed_mps", 0.5}, {"size_m", {0.4, 0.4, 1.7}}}};
  text["laser"] = {{"position_m", {0, 0, 0.3}},
                   {"beams", 3},
                   {"field_of_view_deg", 180},
                   {"range_noise_m", 0},
                   {"bad_beam_rate", 0}};
  const Scene scene = Parse(text);
  const auto trajectory = Trajectory::Create(scene.path, 1.0);
  auto engine = MakeEngine(1, RandomStream::kLaser);
  const RayCaster rays(scene.room_m, scene.furniture);
  EXPECT_NEAR(ScanLaser(scene, rays, *trajectory, 0.0, engine)[1], 2.8, 1e-9);
  EXPECT_NEAR(ScanLaser(scene, rays, *trajectory, 2.0, engine)[1], 1.8, 1e-9);
  EXPECT_NEAR(ScanLaser(scene, rays, *trajectory, 6.0, engine)[1], 1.8, 1e-9);  // on the way back
}

}  // namespace
}  // namespace soundmap::simulation
