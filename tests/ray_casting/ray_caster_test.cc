#include "ray_casting/ray_caster.h"

#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

using geometry::RadFromDeg;

constexpr frames::TimeNs kMid_ns = 1'700'000'000'000'000'000;

acoustics::LikelihoodScan LikelihoodOf(int directions, float likelihood) {
  acoustics::LikelihoodScan scan;
  scan.begin_ns = kMid_ns - 68'750'000;
  scan.end_ns = kMid_ns + 68'750'000;
  scan.likelihood.assign(directions, likelihood);
  return scan;
}

localization::PoseEstimate PoseAt(double x_m, double y_m, double yaw_deg) {
  localization::PoseEstimate pose;
  pose.stamp_ns = kMid_ns;
  pose.map_from_base = {x_m, y_m, RadFromDeg(yaw_deg)};
  pose.state = localization::State::kTracking;
  return pose;
}

// The walls of a box around the origin, a point every 5 cm, in the frame of the box.
std::vector<Eigen::Vector3d> BoxWalls(const Eigen::Vector3d& min, const Eigen::Vector3d& max) {
  std::vector<Eigen::Vector3d> points;
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3;
    const int v = (axis + 2) % 3;
    for (double a = min[u]; a <= max[u]; a += 0.05) {
      for (double b = min[v]; b <= max[v]; b += 0.05) {
        for (const double wall : {min[axis], max[axis]}) {
          Eigen::Vector3d point;
          point[axis] = wall;
          point[u] = a;
          point[v] = b;
          points.push_back(point);
        }
      }
    }
  }
  return points;
}

// A source off every axis and out of every plane of symmetry, seen by an array that is mounted
// askew on a robot that stands askew and has moved since the LIDAR scan. The place is built in the
// map and taken into each frame by its own transform, so that a wrong sign, order or inverse
// anywhere puts the evidence elsewhere.
TEST(RayCaster, ASourceOffTheAxesLandsInItsVoxel) {
  const Eigen::Vector3d source_in_map(3.12, 4.57, 2.30);
  const Eigen::Isometry3d map_from_audio_base =
      geometry::Pose2{1.3, 2.4, RadFromDeg(37.0)}.ToIsometry();
  const Eigen::Isometry3d map_from_lidar_base =
      geometry::Pose2{1.1, 2.55, RadFromDeg(21.0)}.ToIsometry();
  const Eigen::Isometry3d base_from_array =
      Eigen::Translation3d(0.12, -0.07, 0.95) *
      Eigen::AngleAxisd(RadFromDeg(70.0), Eigen::Vector3d(0.3, -0.5, 0.8).normalized());

  std::vector<Eigen::Vector3f> point_in_base;
  for (const Eigen::Vector3d& point_in_map : BoxWalls({0.0, 0.0, 0.0}, {5.0, 6.0, 2.3})) {
    point_in_base.push_back((map_from_lidar_base.inverse() * point_in_map).cast<float>());
  }
  const Eigen::Vector3d to_source_in_array =
      ((map_from_audio_base * base_from_array).inverse() * source_in_map).normalized();

  const auto grid = geometry::DirectionGrid::EqualArea(RadFromDeg(2.0));
  auto likelihood = LikelihoodOf(grid.size(), 0.1f);
  int nearest = 0;
  for (int i = 0; i < grid.size(); ++i) {
    if (grid[i].dot(to_source_in_array) > grid[nearest].dot(to_source_in_array)) nearest = i;
  }
  likelihood.likelihood[nearest] = 0.9f;
  likelihood.maxima = {nearest};

  const auto caster = RayCaster::Create(PaperConfig(), grid, base_from_array).value();
  LidarView lidar{kMid_ns - 200'000'000, point_in_base,
                  map_from_lidar_base.inverse() * map_from_audio_base};
  const auto evidence = caster.Cast(likelihood, lidar, PoseAt(1.3, 2.4, 37.0)).value();
  EXPECT_EQ(evidence.stamp_ns, kMid_ns);
  ASSERT_EQ(evidence.maxima.size(), 1u);
  int speaking = 0;
  for (const auto& end_point : evidence.end_points) {
    const Eigen::Vector3d voxel_in_map = geometry::PointFromKey(end_point.key, 0.05);
    // Half a voxel's diagonal, and what 3 degrees at a slant make of the range.
    EXPECT_GT(voxel_in_map.minCoeff(), -0.25);
    EXPECT_LT(voxel_in_map.z(), 2.3 + 0.25);
    if (end_point.likelihood < 0.5f) continue;
    ++speaking;
    EXPECT_EQ(end_point.key, evidence.maxima[0]);
    // 1 degree of grid at 2.9 m, and half a voxel's diagonal.
    EXPECT_LT((voxel_in_map - source_in_map).norm(), 2.9 * RadFromDeg(1.0) + 0.05)
        << voxel_in_map.transpose();
  }
  EXPECT_EQ(speaking, 1);
}

// One direction straight to a wall: the end point in closed form.
TEST(RayCaster, TheRayHasTheRangeOfThePointAndTheDirectionOfTheGrid) {
  const Eigen::Vector3d direction =
      geometry::DirectionFromAngles(RadFromDeg(30.0), RadFromDeg(10.0));
  const Eigen::Vector3d aside = geometry::DirectionFromAngles(RadFromDeg(32.0), RadFromDeg(10.0));
  Eigen::Isometry3d base_from_array = Eigen::Isometry3d::Identity();
  base_from_array.translation() = Eigen::Vector3d(0.2, 0.1, 1.0);
  const Eigen::Vector3f point = (base_from_array.translation() + 4.0 * aside).cast<float>();
  const auto caster =
      RayCaster::Create(PaperConfig(), geometry::DirectionGrid({direction}, 0.02), base_from_array)
          .value();
  const auto evidence =
      caster.Cast(LikelihoodOf(1, 0.7f), {kMid_ns, {&point, 1}}, PoseAt(1.0, 2.0, 90.0)).value();
  ASSERT_EQ(evidence.end_points.size(), 1u);
  const Eigen::Vector3d end_in_base = base_from_array.translation() + 4.0 * direction;
  const Eigen::Vector3d end_in_map(1.0 - end_in_base.y(), 2.0 + end_in_base.x(), end_in_base.z());
  EXPECT_EQ(evidence.end_points[0].key, *geometry::KeyFromPoint(end_in_map, 0.05));
  EXPECT_EQ(evidence.end_points[0].likelihood, 0.7f);
}

TEST(RayCaster, BeyondTheRangeNothingIsUpdated) {
  const auto grid = geometry::DirectionGrid({Eigen::Vector3d::UnitX()}, 0.02);
  const auto caster = RayCaster::Create(PaperConfig(), grid, Eigen::Isometry3d::Identity()).value();
  const Eigen::Vector3f near(5.99f, 0.0f, 0.0f);
  const Eigen::Vector3f far(6.01f, 0.0f, 0.0f);
  const auto scan = LikelihoodOf(1, 0.9f);
  EXPECT_EQ(caster.Cast(scan, {kMid_ns, {&near, 1}}, PoseAt(0, 0, 0))->end_points.size(), 1u);
  EXPECT_TRUE(caster.Cast(scan, {kMid_ns, {&far, 1}}, PoseAt(0, 0, 0))->end_points.empty());
  // A far point that is nearer by direction hides a near one.
  const std::vector<Eigen::Vector3f> both = {{3.0f, 0.02f, 0.0f}, far};
  EXPECT_TRUE(caster.Cast(scan, {kMid_ns, both}, PoseAt(0, 0, 0))->end_points.empty());
}

TEST(RayCaster, DirectionsThatShareAVoxel) {
  std::vector<Eigen::Vector3d> directions;
  for (const double azimuth_deg : {0.0, 0.2, 90.0, 0.4}) {
    directions.push_back(geometry::DirectionFromAngles(RadFromDeg(azimuth_deg), RadFromDeg(0.5)));
  }
  const std::vector<Eigen::Vector3f> points = {{1.01f, 0.01f, 0.01f}, {0.0f, 1.01f, 0.01f}};
  auto scan = LikelihoodOf(4, 0.5f);
  scan.likelihood = {0.4f, 0.9f, 0.3f, 0.1f};
  const geometry::DirectionGrid grid(directions, RadFromDeg(0.2));
  const auto mounting = Eigen::Isometry3d::Identity();

  const auto each = RayCaster::Create(PaperConfig(), grid, mounting)
                        ->Cast(scan, {kMid_ns, points}, PoseAt(0, 0, 0))
                        ->end_points;
  ASSERT_EQ(each.size(), 4u);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(each[i].likelihood, scan.likelihood[i]);
  EXPECT_EQ(each[0].key, each[1].key);
  EXPECT_EQ(each[0].key, each[3].key);

  const auto once = RayCaster::Create(DefaultConfig(), grid, mounting)
                        ->Cast(scan, {kMid_ns, points}, PoseAt(0, 0, 0))
                        ->end_points;
  const std::vector<sound_map::EndPoint> expected = {{each[0].key, 0.9f}, {each[2].key, 0.3f}};
  EXPECT_EQ(once, expected);
}

// A room of 6 x 5 x 3 m with its corner at the origin: walls of one voxel around free air.
std::shared_ptr<octomap::OcTree> MappedRoom() {
  auto octree = std::make_shared<octomap::OcTree>(0.05);
  for (int x = -1; x <= 120; ++x) {
    for (int y = -1; y <= 100; ++y) {
      for (int z = -1; z <= 60; ++z) {
        const bool wall = x < 0 || y < 0 || z < 0 || x == 120 || y == 100 || z == 60;
        octree->setNodeValue(octomap::OcTreeKey(32768 + x, 32768 + y, 32768 + z),
                             wall ? 2.0f : -2.0f, /*lazy_eval=*/true);
      }
    }
  }
  octree->updateInnerOccupancy();
  return octree;
}

// The surface of the room in closed form.
TEST(RayCaster, WithoutALidarTheMapSaysHowFarTheSurfaceIs) {
  RayCastingConfig config = PaperConfig();
  config.range = RangeSource::kMap;
  config.max_range_m = 4.0;
  const auto grid = geometry::DirectionGrid::EqualArea(RadFromDeg(7.0));
  const Eigen::Isometry3d base_from_array =
      Eigen::Translation3d(0.1, 0.0, 1.0) *
      Eigen::AngleAxisd(RadFromDeg(25.0), Eigen::Vector3d(0.2, 0.9, -0.4).normalized());
  EXPECT_EQ(RayCaster::Create(config, grid, base_from_array).status().code(),
            absl::StatusCode::kFailedPrecondition);
  const auto caster =
      RayCaster::Create(config, grid, base_from_array, {MappedRoom(), nullptr}).value();

  const auto pose = PoseAt(3.5, 2.2, 40.0);
  const Eigen::Isometry3d map_from_array = pose.map_from_base.ToIsometry() * base_from_array;
  const Eigen::Vector3d origin = map_from_array.translation();
  const Eigen::Vector3d size(6.0, 5.0, 3.0);
  acoustics::LikelihoodScan scan = LikelihoodOf(grid.size(), 0.0f);
  for (int i = 0; i < grid.size(); ++i) scan.likelihood[i] = static_cast<float>(i);
  const auto evidence = caster.Cast(scan, {}, pose).value();
  std::set<int> reported;
  for (const auto& end_point : evidence.end_points) {
    const int i = static_cast<int>(end_point.likelihood);
    reported.insert(i);
    const Eigen::Vector3d direction = map_from_array.linear() * grid[i];
    double range_m = std::numeric_limits<double>::infinity();
    for (int axis = 0; axis < 3; ++axis) {
      const double to = direction[axis] > 0.0 ? size[axis] : 0.0;
      range_m = std::min(range_m, (to - origin[axis]) / direction[axis]);
    }
    const Eigen::Vector3d surface = origin + range_m * direction;
    EXPECT_LT((geometry::PointFromKey(end_point.key, 0.05) - surface).cwiseAbs().maxCoeff(), 0.051);
    EXPECT_LT(range_m, 4.1);
  }
  EXPECT_GT(reported.size(), grid.size() / 2u);
  EXPECT_LT(reported.size(), static_cast<std::size_t>(grid.size())) << "some are beyond 4 m";
}

// Somebody stands in the middle of the room, where nothing stood when it was mapped, and talks; a
// source hangs on the wall behind.
TEST(RayCaster, WhatIsHeardInSpaceThatIsKnownToBeFreeIsNoEvidence) {
  const auto octree = MappedRoom();
  const Surroundings surroundings{octree, std::make_shared<building::FreeSpace>(octree)};
  const auto grid = geometry::DirectionGrid(
      {Eigen::Vector3d::UnitX(), -Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY()}, 0.02);
  Eigen::Isometry3d base_from_array = Eigen::Isometry3d::Identity();
  base_from_array.translation().z() = 1.5;
  const std::vector<Eigen::Vector3f> points = {{1.5f, 0.0f, 1.5f},    // the person
                                               {-2.02f, 0.0f, 1.5f},  // the wall
                                               {0.0f, 1.0f, 1.5f}};   // a silent person
  auto scan = LikelihoodOf(3, 0.9f);
  scan.likelihood[2] = 0.4f;
  const auto cast = [&](const RayCastingConfig& config, const Surroundings& known) {
    return RayCaster::Create(config, grid, base_from_array, known)
        ->Cast(scan, {kMid_ns, points}, PoseAt(2.0, 2.5, 0.0))
        ->end_points;
  };
  const auto heard = cast(DefaultConfig(), surroundings);
  ASSERT_EQ(heard.size(), 2u);
  EXPECT_EQ(heard[0].likelihood, 0.9f);
  EXPECT_LT(geometry::PointFromKey(heard[0].key, 0.05).x(), 0.0) << "the wall";
  EXPECT_EQ(heard[1].likelihood, 0.4f) << "against a source: no harm where none can be";
  EXPECT_EQ(cast(PaperConfig(), surroundings).size(), 3u);
  EXPECT_EQ(cast(DefaultConfig(), {}).size(), 3u) << "a building known by its floor plan alone";
}

TEST(RayCaster, RefusesWhatItCannotPlace) {
  const auto grid = geometry::DirectionGrid({Eigen::Vector3d::UnitX()}, 0.02);
  const auto caster =
      RayCaster::Create(DefaultConfig(), grid, Eigen::Isometry3d::Identity()).value();
  const Eigen::Vector3f point(2.0f, 0.0f, 0.0f);
  const LidarView lidar{kMid_ns, {&point, 1}};
  ASSERT_TRUE(caster.Cast(LikelihoodOf(1, 0.9f), lidar, PoseAt(0, 0, 0)).ok());

  auto lost = PoseAt(0, 0, 0);
  lost.state = localization::State::kLost;
  EXPECT_EQ(caster.Cast(LikelihoodOf(1, 0.9f), lidar, lost).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(caster.Cast(LikelihoodOf(1, 0.9f), lidar, PoseAt(NAN, 0, 0)).status().code(),
            absl::StatusCode::kInvalidArgument);
  const LidarView stale{kMid_ns - 600'000'000, {&point, 1}};
  EXPECT_EQ(caster.Cast(LikelihoodOf(1, 0.9f), stale, PoseAt(0, 0, 0)).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(caster.Cast(LikelihoodOf(2, 0.9f), lidar, PoseAt(0, 0, 0)).status().code(),
            absl::StatusCode::kInvalidArgument);
  auto faulty = LikelihoodOf(0, 0.9f);
  faulty.fault = "microphone 3 is dead";
  const auto status = caster.Cast(faulty, lidar, PoseAt(0, 0, 0)).status();
  EXPECT_NE(status.message().find("microphone 3 is dead"), absl::string_view::npos);
  // No LIDAR point: nothing to say, but no error.
  EXPECT_TRUE(
      caster.Cast(LikelihoodOf(1, 0.9f), {kMid_ns, {}}, PoseAt(0, 0, 0))->end_points.empty());
  // Outside the octree.
  EXPECT_TRUE(caster.Cast(LikelihoodOf(1, 0.9f), lidar, PoseAt(1e9, 0, 0))->end_points.empty());
}

TEST(RayCaster, AConfigurationThatCannotBeIsRefusedByName) {
  const auto grid = geometry::DirectionGrid({Eigen::Vector3d::UnitX()}, 0.02);
  const auto mounting = Eigen::Isometry3d::Identity();
  RayCastingConfig config;
  config.max_angle_deg = -1.0;
  EXPECT_NE(RayCaster::Create(config, grid, mounting).status().message().find("max_angle_deg"),
            absl::string_view::npos);
  config = {};
  config.max_range_m = NAN;
  EXPECT_NE(RayCaster::Create(config, grid, mounting).status().message().find("max_range_m"),
            absl::string_view::npos);
  EXPECT_FALSE(RayCaster::Create({}, geometry::DirectionGrid({}, 0.02), mounting).ok());
  Eigen::Isometry3d broken = mounting;
  broken.translation().x() = NAN;
  EXPECT_FALSE(RayCaster::Create({}, grid, broken).ok());
}

}  // namespace
}  // namespace soundmap::ray_casting
