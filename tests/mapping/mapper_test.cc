#include "mapping/mapper.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <string>

#include "building/files.h"
#include "building/stored_building.h"
#include "geometry/angles.h"
#include "tests/mapping/box_room.h"

namespace soundmap::mapping {
namespace {

using frames::Frame;
using frames::LidarScan;
using frames::TimeNs;
using geometry::Pose2;
using ::testing::HasSubstr;

double SecondsIntoDrive(TimeNs stamp_ns) {
  return frames::SecondsFromNs(stamp_ns - kDriveStart_ns);
}

absl::StatusOr<MappingResult> Map(const std::vector<Frame>& drive, const DriveModel& model,
                                  std::vector<StampedPose> surveyed = {},
                                  const MapperConfig& config = {}) {
  auto mapper =
      Mapper::Create(config, model.Calibration(), model.MapFromBase(0.0), std::move(surveyed));
  if (!mapper.ok()) return mapper.status();
  for (const Frame& frame : drive) mapper->Add(frame).IgnoreError();
  return mapper->Finish();
}

struct PathError {
  double mean_m = 0.0;
  double max_m = 0.0;
  double max_rad = 0.0;
};

PathError ErrorOf(const std::vector<StampedPose>& path, const DriveModel& model) {
  PathError error;
  for (const StampedPose& pose : path) {
    const Pose2 truth = model.MapFromBase(SecondsIntoDrive(pose.stamp_ns));
    const double error_m =
        std::hypot(pose.map_from_base.x_m - truth.x_m, pose.map_from_base.y_m - truth.y_m);
    error.mean_m += error_m / static_cast<double>(path.size());
    error.max_m = std::max(error.max_m, error_m);
    error.max_rad =
        std::max(error.max_rad,
                 std::abs(geometry::NormalizeAngle(pose.map_from_base.yaw_rad - truth.yaw_rad)));
  }
  return error;
}

// Half the range of the yaw's error: what is left without that of the map's frame.
double YawSpread(const std::vector<StampedPose>& path, const DriveModel& model) {
  double min_rad = std::numeric_limits<double>::infinity();
  double max_rad = -min_rad;
  for (const StampedPose& pose : path) {
    const Pose2 truth = model.MapFromBase(SecondsIntoDrive(pose.stamp_ns));
    const double error_rad = geometry::NormalizeAngle(pose.map_from_base.yaw_rad - truth.yaw_rad);
    min_rad = std::min(min_rad, error_rad);
    max_rad = std::max(max_rad, error_rad);
  }
  return 0.5 * (max_rad - min_rad);
}

struct SurfaceError {
  int occupied = 0;
  double near = 0.0;  // occupied voxels whose centre is within one voxel of a surface
  double max_m = 0.0;
  int free_in_solid = 0;  // free voxels deeper than one voxel in a wall or in furniture
};

SurfaceError ErrorOf(const octomap::OcTree& octree, const BoxRoom& room) {
  octomap::OcTree leaves(octree);
  leaves.expand();
  SurfaceError error;
  for (auto leaf = leaves.begin_leafs(); leaf != leaves.end_leafs(); ++leaf) {
    const double distance_m = room.SignedDistance({leaf.getX(), leaf.getY(), leaf.getZ()});
    if (!leaves.isNodeOccupied(*leaf)) {
      error.free_in_solid += distance_m < -0.05;
      continue;
    }
    ++error.occupied;
    error.near += std::abs(distance_m) <= 0.05 + 1e-6;
    error.max_m = std::max(error.max_m, std::abs(distance_m));
  }
  error.near /= error.occupied;
  return error;
}

DriveModel DriftingModel() {
  return {.range_noise_m = 0.015, .odometry_scale = 0.96, .odometry_yaw_scale = 0.97};
}

TEST(Mapper, RemovesTheDriftOfASweptDrive) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const DriveModel model = DriftingModel();
  const auto drive = SimulateDrive(room, model, 1);
  const auto result = Map(drive, model);
  ASSERT_TRUE(result.ok()) << result.status();
  const MappingReport& report = result->report;
  EXPECT_GT(report.drift_removed_m, 0.3);
  EXPECT_EQ(report.scans, 79);
  EXPECT_EQ(report.path.size(), 79u);
  EXPECT_EQ(report.scans_dropped, 0);
  EXPECT_EQ(report.scans_unregistered, 0);
  EXPECT_GT(report.key_scans, 35);
  EXPECT_LT(report.mean_residual_m, 0.015);
  const PathError path = ErrorOf(report.path, model);
  EXPECT_LT(path.max_m, 0.02);
  // Of which 0.18 degrees before the first scan, where there is only the odometry.
  EXPECT_LT(path.max_rad, geometry::RadFromDeg(0.28));
  EXPECT_LT(YawSpread(report.path, model), geometry::RadFromDeg(0.1));

  const SurfaceError surfaces = ErrorOf(*result->building.octree, room);
  EXPECT_GT(surfaces.occupied, 50000);
  EXPECT_GT(surfaces.near, 0.99);
  EXPECT_LT(surfaces.max_m, 0.13);
  EXPECT_EQ(surfaces.free_in_solid, 0);
}

TEST(Mapper, TheFloorPlanIsTheSliceAtTheLaser) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const DriveModel model{.duration_s = 20.0};
  const auto result = Map(SimulateDrive(room, model, 1), model);
  ASSERT_TRUE(result.ok()) << result.status();
  const building::FloorPlan& plan = result->building.floor_plan;
  EXPECT_NEAR(plan.width() * plan.cell_size_m(), 8.0, 0.15);
  EXPECT_NEAR(plan.height() * plan.cell_size_m(), 6.0, 0.15);
  int free = 0, occupied = 0;
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      const Eigen::Vector2d centre =
          plan.origin_in_map_m() + plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
      const double distance_m = room.SignedDistance({centre.x(), centre.y(), 0.3});
      if (plan.at(column, row) == building::Cell::kFree) {
        ++free;
        EXPECT_GT(distance_m, -0.05) << centre.transpose();
      } else if (plan.at(column, row) == building::Cell::kOccupied) {
        ++occupied;
        EXPECT_LT(std::abs(distance_m), 0.1) << centre.transpose();
      }
    }
  }
  EXPECT_GT(free * 0.05 * 0.05, 35.0);
  EXPECT_GT(occupied * 0.05, 25.0);
}

// A LIDAR at 1.2 m that looks down by 35 degrees at most sees the slice only from 1.3 m on. The
// robot turns in the middle of a small room, so that its LIDAR never sees the slice there.
TEST(Mapper, TheFloorPlanIsFreeWhereTheLaserSawThrough) {
  const BoxRoom room({4.0, 4.0, 3.0}, {{{3.2, 1.0, 0.0}, {4.0, 1.6, 1.0}}});
  DriveModel model{.duration_s = 20.0, .lap_s = 20.0, .centre = {2.0, 2.0}, .radius = {0.5, 0.5}};
  const auto unknown_in_reach = [&](const DriveModel& drive_model) {
    const auto result = Map(SimulateDrive(room, drive_model, 1), drive_model);
    EXPECT_TRUE(result.ok()) << result.status();
    const building::FloorPlan& plan = result->building.floor_plan;
    int unknown = 0;
    for (int row = 0; row < plan.height(); ++row) {
      for (int column = 0; column < plan.width(); ++column) {
        const Eigen::Vector2d centre =
            plan.origin_in_map_m() + plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
        const double distance_m = room.SignedDistance({centre.x(), centre.y(), 0.3});
        const building::Cell cell = plan.at(column, row);
        unknown += distance_m > 0.25 && cell == building::Cell::kUnknown;
        if (cell != building::Cell::kFree) continue;
        EXPECT_GT(distance_m, -0.1) << centre.transpose();
      }
    }
    return unknown;
  };
  EXPECT_GT(unknown_in_reach(model), 500);
  model.laser_beams = 360;
  EXPECT_EQ(unknown_in_reach(model), 0);
  // Readings that are too far and stamps that are late make nothing free behind the walls, of which
  // few rings show little.
  model.laser_outlier_share = 0.02;
  model.laser_stamp_late_s = 0.1;
  model.rings = 6;
  model.lap_s = 8.0;
  EXPECT_EQ(unknown_in_reach(model), 0);
}

// Without the straightening of sweeps a scan of a turning robot is bent.
TEST(Mapper, SweptAndInstantaneousScansGiveTheSamePath) {
  const BoxRoom room = BoxRoom::WithFurniture();
  for (const bool swept : {true, false}) {
    const DriveModel model{.duration_s = 15.0, .lap_s = 15.0, .swept = swept};
    const auto result = Map(SimulateDrive(room, model, 1), model);
    ASSERT_TRUE(result.ok()) << result.status();
    const PathError path = ErrorOf(result->report.path, model);
    EXPECT_LT(path.max_m, 0.01) << swept;
    EXPECT_LT(path.max_rad, geometry::RadFromDeg(0.1)) << swept;
  }
  DriveModel bent{.duration_s = 15.0, .lap_s = 15.0, .swept = true};
  auto drive = SimulateDrive(room, bent, 1);
  for (Frame& frame : drive) {
    if (auto* scan = std::get_if<LidarScan>(&frame)) scan->time_offset_ns.clear();
  }
  const auto result = Map(drive, bent);
  EXPECT_TRUE(!result.ok() || ErrorOf(result->report.path, bent).max_m > 0.03);
}

// The map's frame is what the initial pose says, however the scans are relaxed.
TEST(Mapper, TheFirstScanAnchorsTheMap) {
  const DriveModel model{.duration_s = 10.0, .range_noise_m = 0.03};
  const auto result = Map(SimulateDrive(BoxRoom::WithFurniture(), model, 1), model);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(ErrorOf({result->report.path.front()}, model).max_m, 2e-4);
  EXPECT_LT(ErrorOf({result->report.path.front()}, model).max_rad, 1e-4);
  EXPECT_GT(ErrorOf(result->report.path, model).max_m, 5e-4);
}

TEST(Mapper, EqualDrivesGiveEqualBytes) {
  const BoxRoom room = BoxRoom::WithFurniture();
  DriveModel model = DriftingModel();
  model.duration_s = 10.0;
  const auto drive = SimulateDrive(room, model, 1);
  const auto first = Map(drive, model);
  const auto second = Map(drive, model);
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(first->report.path, second->report.path);
  EXPECT_EQ(building::SerializeBuilding(first->building),
            building::SerializeBuilding(second->building));
}

TEST(Mapper, SurveyedPosesAreUsedInsteadOfRegistration) {
  const BoxRoom room = BoxRoom::WithFurniture();
  DriveModel model = DriftingModel();
  model.duration_s = 12.0;
  // The survey's frame is not the one that the initial pose says.
  const Pose2 survey_from_map{20.0, -10.0, 1.0};
  std::vector<StampedPose> surveyed;
  for (double time_s = 2.0; time_s <= 9.0; time_s += 1.0) {
    surveyed.push_back(
        {kDriveStart_ns + std::llround(time_s * 1e9), survey_from_map * model.MapFromBase(time_s)});
  }
  const auto result = Map(SimulateDrive(room, model, 1), model, surveyed);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_GT(result->report.path.size(), 12u);
  EXPECT_EQ(result->report.path.size() + result->report.scans_dropped,
            static_cast<std::size_t>(result->report.scans));
  for (const StampedPose& pose : result->report.path) {
    const double time_s = SecondsIntoDrive(pose.stamp_ns);
    EXPECT_GE(time_s, 2.0);
    EXPECT_LE(time_s, 9.0);
    // At most a second of odometry with 4 % error lies between two surveyed poses.
    const Pose2 truth = survey_from_map * model.MapFromBase(time_s);
    EXPECT_NEAR(pose.map_from_base.x_m, truth.x_m, 0.005);
    EXPECT_NEAR(pose.map_from_base.y_m, truth.y_m, 0.005);
    EXPECT_NEAR(geometry::NormalizeAngle(pose.map_from_base.yaw_rad - truth.yaw_rad), 0.0, 0.005);
  }
  const auto occupied_near = [&](const Eigen::Vector3d& point_in_map) {
    const Eigen::Vector3d point = survey_from_map.ToIsometry() * point_in_map;
    // A ring of the LIDAR passes within 0.1 m.
    for (double dx : {-0.05, 0.0, 0.05}) {
      for (double dy : {-0.05, 0.0, 0.05}) {
        for (double dz : {-0.1, -0.05, 0.0, 0.05, 0.1}) {
          const auto* node =
              result->building.octree->search(point.x() + dx, point.y() + dy, point.z() + dz);
          if (node && result->building.octree->isNodeOccupied(node)) return true;
        }
      }
    }
    return false;
  };
  EXPECT_TRUE(occupied_near({8.0, 3.0, 1.2}));
  EXPECT_TRUE(occupied_near({5.5, 6.0, 1.2}));
  EXPECT_FALSE(occupied_near({6.0, 4.0, 1.2}));
}

TEST(Mapper, SurveyedPosesAreChecked) {
  const DriveModel model;
  const auto create = [&](std::vector<StampedPose> surveyed) {
    return Mapper::Create({}, model.Calibration(), {}, std::move(surveyed)).status();
  };
  EXPECT_TRUE(create({{1, {}}, {2, {}}}).ok());
  EXPECT_FALSE(create({{1, {}}}).ok());
  EXPECT_FALSE(create({{2, {}}, {1, {}}}).ok());
  EXPECT_FALSE(create({{1, {}}, {1, {}}}).ok());
  EXPECT_FALSE(create({{1, {}}, {2, {std::nan(""), 0, 0}}}).ok());
  EXPECT_FALSE(create({{-1, {}}, {2, {}}}).ok());
  EXPECT_FALSE(create({{1, {}}, {std::numeric_limits<TimeNs>::max(), {}}}).ok());
  // None of the drive's scans lies between them.
  DriveModel short_drive{.duration_s = 2.0};
  const auto result =
      Map(SimulateDrive(BoxRoom::WithFurniture(), short_drive, 1), short_drive, {{1, {}}, {2, {}}});
  EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(result.status().message()), HasSubstr("surveyed"));
}

TEST(Mapper, AnOdometryJumpIsBridged) {
  const BoxRoom room = BoxRoom::WithFurniture();
  DriveModel model{.duration_s = 20.0, .range_noise_m = 0.01};
  auto drive = SimulateDrive(room, model, 1);
  // Ten metres and half a turn at 8 s, as after a restart of the wheel controller.
  const Pose2 jumped_from_odom{10.0, -3.0, geometry::kPi};
  for (Frame& frame : drive) {
    if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      if (SecondsIntoDrive(odometry->stamp_ns) < 8.0) continue;
      odometry->odom_from_base = jumped_from_odom * odometry->odom_from_base;
    }
  }
  const auto result = Map(drive, model);
  ASSERT_TRUE(result.ok()) << result.status();
  // The sweep during which it jumped is left out.
  EXPECT_EQ(result->report.scans_dropped, 1);
  EXPECT_EQ(result->report.scans_unregistered, 0);
  EXPECT_LT(ErrorOf(result->report.path, model).max_m, 0.02);
  EXPECT_GT(ErrorOf(*result->building.octree, room).near, 0.98);
}

TEST(Mapper, ProgressRunsForwardAndCancels) {
  DriveModel model{.duration_s = 5.0};
  const auto drive = SimulateDrive(BoxRoom::WithFurniture(), model, 1);
  for (const double cancel_at : {0.0, 0.3, 0.7, 2.0}) {
    auto mapper = Mapper::Create({}, model.Calibration(), {});
    ASSERT_TRUE(mapper.ok());
    for (const Frame& frame : drive) ASSERT_TRUE(mapper->Add(frame).ok());
    std::vector<double> steps;
    const auto result = mapper->Finish([&](double done) {
      steps.push_back(done);
      return done < cancel_at;
    });
    ASSERT_FALSE(steps.empty());
    EXPECT_TRUE(std::is_sorted(steps.begin(), steps.end()));
    EXPECT_GE(steps.front(), 0.0);
    if (cancel_at < 1.0) {
      EXPECT_EQ(result.status().code(), absl::StatusCode::kCancelled);
    } else {
      EXPECT_TRUE(result.ok());
      EXPECT_EQ(steps.back(), 1.0);
    }
    EXPECT_EQ(mapper->Finish().status().code(), absl::StatusCode::kFailedPrecondition);
  }
}

// A drive without what it takes says so.
TEST(Mapper, SaysWhatADriveLacks) {
  DriveModel model{.duration_s = 3.0};
  const auto drive = SimulateDrive(BoxRoom::WithFurniture(), model, 1);
  const auto message = [&](auto change) {
    std::vector<Frame> changed;
    for (Frame frame : drive) {
      if (change(frame)) changed.push_back(std::move(frame));
    }
    const auto result = Map(changed, model);
    EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(result.status().message());
  };
  const auto is_scan = [](const Frame& frame) { return std::holds_alternative<LidarScan>(frame); };
  EXPECT_THAT(message([](Frame&) { return false; }), HasSubstr("no LIDAR"));
  EXPECT_THAT(message([&](Frame& frame) { return !is_scan(frame); }), HasSubstr("no LIDAR"));
  EXPECT_THAT(message([&](Frame& frame) { return is_scan(frame); }), HasSubstr("no odometry"));
  for (const float value : {0.0f, std::nanf(""), std::numeric_limits<float>::infinity(), 1e30f}) {
    EXPECT_THAT(message([&](Frame& frame) {
                  if (auto* scan = std::get_if<LidarScan>(&frame)) {
                    for (auto& point : scan->point_in_lidar) point.setConstant(value);
                  }
                  return true;
                }),
                HasSubstr("point"))
        << value;
  }
  EXPECT_THAT(message([&](Frame& frame) {
                if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
                  odometry->stamp_ns += 1'000'000'000'000;
                }
                return true;
              }),
              HasSubstr("without odometry"));
}

TEST(Mapper, MalformedFramesAreRefusedAndTheRestIsMapped) {
  DriveModel model{.duration_s = 4.0};
  const auto drive = SimulateDrive(BoxRoom::WithFurniture(), model, 1);
  auto mapper = Mapper::Create({}, model.Calibration(), model.MapFromBase(0.0));
  ASSERT_TRUE(mapper.ok());
  LidarScan scan{
      .stamp_ns = kDriveStart_ns, .point_in_lidar = {{1, 1, 1}}, .time_offset_ns = {1, 2}};
  EXPECT_EQ(mapper->Add(scan).code(), absl::StatusCode::kInvalidArgument);
  scan.time_offset_ns.clear();
  for (const TimeNs stamp_ns :
       {TimeNs{-1}, std::numeric_limits<TimeNs>::max(), std::numeric_limits<TimeNs>::min()}) {
    scan.stamp_ns = stamp_ns;
    EXPECT_FALSE(mapper->Add(scan).ok());
    EXPECT_FALSE(mapper->Add(frames::Odometry{stamp_ns, {}}).ok());
  }
  EXPECT_TRUE(mapper->Add(frames::LaserScan{}).ok());
  EXPECT_FALSE(mapper->Add(frames::LaserScan{.stamp_ns = -1}).ok());
  EXPECT_FALSE(mapper->Add(frames::LaserScan{.start_angle_rad = std::nan("")}).ok());
  EXPECT_FALSE(mapper->Add(frames::LaserScan{.range_m = std::vector<float>(100'000, 1.0f)}).ok());
  const float nan = std::nanf("");
  const float infinity = std::numeric_limits<float>::infinity();
  EXPECT_TRUE(mapper
                  ->Add(frames::LaserScan{.stamp_ns = kDriveStart_ns,
                                          .angle_increment_rad = 0.01,
                                          .range_m = {nan, infinity, -1.0f, 1e30f, 0.0f, 2.0f}})
                  .ok());
  EXPECT_TRUE(mapper->Add(frames::AudioBlock{}).ok());
  EXPECT_TRUE(mapper->Add(frames::Odometry{kDriveStart_ns, {std::nan(""), 0, 0}}).ok());
  for (const Frame& frame : drive) {
    ASSERT_TRUE(mapper->Add(frame).ok());
    // Every scan twice: the second is not newer.
    if (std::holds_alternative<LidarScan>(frame)) {
      ASSERT_TRUE(mapper->Add(frame).ok());
    }
  }
  const auto result = mapper->Finish();
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->report.path.size(), 7u);
  EXPECT_EQ(result->report.scans_dropped, 7 + 4);
  EXPECT_LT(ErrorOf(result->report.path, model).max_m, 0.01);
}

TEST(Mapper, ConfigurationIsValidated) {
  const frames::Calibration calibration;
  for (const MapperConfig& config : {
           MapperConfig{.voxel_size_m = 0.0},
           MapperConfig{.voxel_size_m = std::nan("")},
           MapperConfig{.occupancy = {.hit_log_odds = -1.0}},
           MapperConfig{.min_range_m = 5.0, .max_range_m = 5.0},
           MapperConfig{.max_range_m = std::numeric_limits<double>::infinity()},
           MapperConfig{.slice_half_thickness_m = -0.1},
           MapperConfig{.slice_height_m = std::nan("")},
           MapperConfig{.surface_voxel_size_m = 0.0},
           MapperConfig{.key_scan_distance_m = -1.0},
           MapperConfig{.key_scan_angle_rad = std::nan("")},
           MapperConfig{.key_scans_per_place = 0},
           MapperConfig{.relaxation_passes = -1},
           MapperConfig{.max_speed_mps = 0.0},
           MapperConfig{.max_turn_rate_radps = std::nan("")},
       }) {
    EXPECT_EQ(Mapper::Create(config, calibration, {}).status().code(),
              absl::StatusCode::kInvalidArgument);
  }
  EXPECT_TRUE(Mapper::Create({}, calibration, {}).ok());
  EXPECT_FALSE(Mapper::Create({}, calibration, {std::nan(""), 0, 0}).ok());
  frames::Calibration broken;
  broken.base_from_lidar.translation().x() = std::nan("");
  EXPECT_FALSE(Mapper::Create({}, broken, {}).ok());
}

// A robot that stands, or drives one lap again and again, must not make the memory grow.
TEST(Mapper, APlaceKeepsSoManyScans) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const DriveModel model{.duration_s = 60.0, .lap_s = 10.0, .rings = 8, .columns = 120};
  const auto result = Map(SimulateDrive(room, model, 1), model, {},
                          {.key_scans_per_place = 1, .relaxation_passes = 0});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->report.path.size(), 119u);
  EXPECT_LT(result->report.key_scans, 25);
}

// The hall of the shared data, 25 m wide, seen through its octree.
TEST(Mapper, MapsARealHall) {
  const char* data = std::getenv("SOUNDMAP_DATA");
  const std::string path =
      std::string(data ? data : SOUNDMAP_SOURCE_DIR "/../shared/data") + "/catec/catec.bt";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "the shared hall is not at " << path;
  const auto hall = building::ImportBuilding(path, {});
  ASSERT_TRUE(hall.ok()) << hall.status();
  const octomap::OcTree& truth = *hall->octree;
  const World world = [&](const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
    const octomap::point3d from(origin.x(), origin.y(), origin.z());
    const octomap::point3d along(direction.x(), direction.y(), direction.z());
    octomap::point3d centre, surface;
    if (!truth.castRay(from, along, centre, /*ignoreUnknownCells=*/true, 20.0) ||
        !truth.getRayIntersection(from, along, centre, surface)) {
      return std::numeric_limits<double>::infinity();
    }
    return static_cast<double>((surface - from).norm());
  };
  const DriveModel model{.lap_s = 40.0,
                         .centre = {0.0, -0.3},
                         .radius = {5.0, 3.0},
                         .lidar_period_s = 1.0,
                         .rings = 20,
                         .columns = 180,
                         .range_noise_m = 0.01,
                         .odometry_scale = 0.97,
                         .odometry_yaw_scale = 0.98};
  const auto result = Map(SimulateDrive(world, model, 1), model);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->report.scans_unregistered, 0);
  const PathError error = ErrorOf(result->report.path, model);
  EXPECT_LT(error.mean_m, 0.04);
  EXPECT_LT(error.max_m, 0.08);
  EXPECT_LT(error.max_rad, geometry::RadFromDeg(0.6));

  octomap::OcTree leaves(*result->building.octree);
  leaves.expand();
  int occupied = 0, near = 0;
  for (auto leaf = leaves.begin_leafs(); leaf != leaves.end_leafs(); ++leaf) {
    if (!leaves.isNodeOccupied(*leaf)) continue;
    ++occupied;
    bool found = false;
    for (int i = 0; i < 27 && !found; ++i) {
      const octomap::OcTreeKey key = leaf.getKey();
      const auto* node = truth.search(
          octomap::OcTreeKey(key[0] + i % 3 - 1, key[1] + i / 3 % 3 - 1, key[2] + i / 9 - 1));
      found = node && truth.isNodeOccupied(node);
    }
    near += found;
  }
  EXPECT_GT(occupied, 20000);
  EXPECT_GT(static_cast<double>(near) / occupied, 0.95);
}

}  // namespace
}  // namespace soundmap::mapping
