#include "mapping/registration.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "building/point_cloud_file.h"
#include "geometry/angles.h"
#include "mapping/point_thinning.h"
#include "tests/mapping/box_room.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;

double Apart_m(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return (a.translation() - b.translation()).norm();
}

double Apart_rad(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle();
}

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
    const Registration found =
        Register(points, map, start.ToIsometry(),
                 {.start_distance_m = 0.5, .prior_std_m = 1.0, .prior_std_rad = 1.0});
    EXPECT_LT(Apart_m(found.map_from_base, truth.ToIsometry()), 0.005) << i;
    EXPECT_LT(Apart_rad(found.map_from_base, truth.ToIsometry()), 0.0015) << i;
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
  const Registration found = Register(points, map, truth.ToIsometry(), {});
  EXPECT_LT(Apart_m(found.map_from_base, truth.ToIsometry()), 0.01);
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
  const Registration found = Register(points, map, Pose2{0.1, 0.1, 0.05}.ToIsometry(), {});
  EXPECT_NEAR(found.map_from_base.translation().x(), 0.1, 0.01);
  EXPECT_NEAR(found.map_from_base.translation().y(), 0.0, 0.005);
  EXPECT_LT(Apart_rad(found.map_from_base, Eigen::Isometry3d::Identity()), 0.001);
  EXPECT_LT(found.information(0, 0), 1e-3 * found.information(1, 1));
}

// A closed room seen from a robot that stands askew: all six degrees of freedom.
TEST(Registration, FindsHeightAndTiltToo) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const DriveModel model{.range_noise_m = 0.01};
  SurfacePyramid map(0.2, 4);
  std::mt19937 random(3);
  for (double time_s = 0.0; time_s < model.lap_s; time_s += 4.0) {
    const Pose2 map_from_base = model.MapFromBase(time_s);
    auto points = ScanInBase(room, model, map_from_base, random);
    for (Eigen::Vector3f& point : points) {
      point = map_from_base.ToIsometry().cast<float>() * point;
    }
    map.Insert(points);
  }
  map.FitPlanes();
  std::uniform_real_distribution<double> any(-1.0, 1.0);
  int lost = 0;
  for (int i = 0; i < 20; ++i) {
    const auto points = ScanInBase(room, model, model.MapFromBase(1.3 * i), random);
    const Eigen::Isometry3d truth = model.MapFromBase(1.3 * i).ToIsometry();
    Eigen::Vector3d shift(any(random), any(random), any(random));
    Eigen::Vector3d axis(any(random), any(random), any(random));
    Eigen::Isometry3d start = truth;
    start.translation() += 0.5 * shift.normalized();
    start.linear() =
        Eigen::AngleAxisd(geometry::RadFromDeg(10.0), axis.normalized()) * truth.linear();
    const Registration found = RegisterCoarseToFine(points, map, start,
                                                    {.start_distance_m = 1.6,
                                                     .prior_std_m = 10.0,
                                                     .prior_std_rad = 1.0,
                                                     .prior_std_z_m = 10.0,
                                                     .prior_std_tilt_rad = 1.0});
    lost += Apart_m(found.map_from_base, truth) > 0.01 ||
            Apart_rad(found.map_from_base, truth) > geometry::RadFromDeg(0.1);
  }
  EXPECT_EQ(lost, 0);
}

std::vector<Eigen::Vector3f> ReadPly(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  std::vector<Eigen::Vector3f> points;
  const std::vector<Eigen::Vector3d> file_points = building::ParsePly(bytes).value();
  for (const Eigen::Vector3d& point : file_points) {
    points.push_back(point.cast<float>());
  }
  return points;
}

// Two frames of a real LIDAR on a car.
TEST(Registration, ARealPairFromFarStarts) {
  const char* data = std::getenv("SOUNDMAP_DATA");
  const std::string folder =
      std::string(data ? data : SOUNDMAP_SOURCE_DIR "/../shared/data") + "/registration_pair/";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "the sample pair is not at " << folder;
  const auto source = ReadPly(folder + "source.ply");
  Eigen::Isometry3d truth;
  std::ifstream matrix(folder + "T_target_source.txt");
  for (int i = 0; i < 16; ++i) matrix >> truth.matrix()(i / 4, i % 4);
  SurfacePyramid map(0.4, 4);
  map.Insert(ReadPly(folder + "target.ply"));
  map.FitPlanes();
  std::mt19937 random(1);
  std::normal_distribution<double> any(0.0, 1.0);
  const int starts = std::getenv("SOUNDMAP_STARTS") ? std::atoi(std::getenv("SOUNDMAP_STARTS")) : 5;
  for (int i = 0; i < starts; ++i) {
    const Eigen::Vector3d shift(any(random), any(random), any(random));
    const Eigen::Vector3d axis(any(random), any(random), any(random));
    Eigen::Isometry3d start = truth;
    start.translation() += shift.normalized();
    start.linear() =
        Eigen::AngleAxisd(geometry::RadFromDeg(10.0), axis.normalized()) * truth.linear();
    const Registration found = RegisterFromFar(source, map, start,
                                               {.start_distance_m = 4.0,
                                                .prior_std_m = 1.0,
                                                .prior_std_rad = 0.17,
                                                .prior_std_z_m = 1.0,
                                                .prior_std_tilt_rad = 0.17});
    EXPECT_LT(Apart_m(found.map_from_base, truth), 0.05) << i;
    EXPECT_LT(Apart_rad(found.map_from_base, truth), geometry::RadFromDeg(0.3)) << i;
  }
}

TEST(Registration, WithoutAMapThePoseStays) {
  const SurfaceMap map(0.2);
  const Eigen::Isometry3d start = Pose2{1.0, 2.0, 3.0}.ToIsometry();
  const std::vector<Eigen::Vector3f> points = {{1, 1, 1}, {std::nanf(""), 0, 0}};
  for (const auto& scan : {points, std::vector<Eigen::Vector3f>{}}) {
    const Registration found = Register(scan, map, start, {});
    EXPECT_LT(Apart_m(found.map_from_base, start), 1e-12);
    EXPECT_LT(Apart_rad(found.map_from_base, start), 1e-12);
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

TEST(PointsToAlign, StandForThoseLeftOut) {
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 100 * 100; ++i) {
    points.emplace_back(static_cast<float>(i % 100), static_cast<float>(i / 100), 0.1f);
  }
  const AlignedPoints few = PointsToAlign(std::span(points).first(500), 0.2);
  EXPECT_EQ(few.points.size(), 500u);
  EXPECT_EQ(few.stands_for, 1.0);
  const AlignedPoints many = PointsToAlign(points, 0.2);
  EXPECT_NEAR(static_cast<double>(many.points.size()), 4000.0, 2.0);
  EXPECT_DOUBLE_EQ(many.stands_for * static_cast<double>(many.points.size()), 10000.0);
  // From all parts of the scan, whatever the length of its rows.
  int last_quarter = 0, every_fifth = 0;
  for (const Eigen::Vector3f& point : many.points) {
    last_quarter += point.y() >= 75.0f;
    every_fifth += static_cast<int>(point.x()) % 5 == 0;
  }
  EXPECT_NEAR(last_quarter, 1000.0, 10.0);
  EXPECT_NEAR(every_fifth, 800.0, 10.0);
}

}  // namespace
}  // namespace soundmap::mapping
