// Loops, several drives, and buildings that are extended.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <cmath>
#include <memory>
#include <string>

#include "geometry/angles.h"
#include "mapping/mapper.h"
#include "tests/mapping/box_room.h"

namespace soundmap::mapping {
namespace {

using frames::Frame;
using frames::TimeNs;
using geometry::Pose2;
using ::testing::HasSubstr;

double MaxError_m(std::span<const StampedPose> path, const DriveModel& model, TimeNs later_ns = 0) {
  double max_m = 0.0;
  for (const StampedPose& pose : path) {
    const Pose2 truth =
        model.MapFromBase(frames::SecondsFromNs(pose.stamp_ns - later_ns - kDriveStart_ns));
    max_m = std::max(
        max_m, std::hypot(pose.map_from_base.x_m - truth.x_m, pose.map_from_base.y_m - truth.y_m));
  }
  return max_m;
}

// The part of the path that is drive `drive`'s.
std::span<const StampedPose> PathOf(const MappingReport& report, std::size_t drive) {
  const std::span<const StampedPose> all(report.path);
  const std::size_t begin = report.drive_begin[drive];
  const std::size_t end =
      drive + 1 < report.drive_begin.size() ? report.drive_begin[drive + 1] : all.size();
  return all.subspan(begin, end - begin);
}

std::vector<Frame> Later(std::vector<Frame> drive, TimeNs later_ns) {
  for (Frame& frame : drive) {
    std::visit([later_ns](auto& content) { content.stamp_ns += later_ns; }, frame);
  }
  return drive;
}

void AddAll(Mapper& mapper, const std::vector<Frame>& drive) {
  for (const Frame& frame : drive) ASSERT_TRUE(mapper.Add(frame).ok());
}

// Share of the occupied voxels that lie within a voxel's size of a surface.
double NearSurfaces(const octomap::OcTree& octree, const BoxRoom& room) {
  octomap::OcTree leaves(octree);
  leaves.expand();
  int occupied = 0, near = 0;
  for (auto leaf = leaves.begin_leafs(); leaf != leaves.end_leafs(); ++leaf) {
    if (!leaves.isNodeOccupied(*leaf)) continue;
    ++occupied;
    near += std::abs(room.SignedDistance({leaf.getX(), leaf.getY(), leaf.getZ()})) <= 0.051;
  }
  return static_cast<double>(near) / occupied;
}

bool OccupiedNear(const octomap::OcTree& octree, const Eigen::Vector3d& point) {
  for (double dx : {-0.05, 0.0, 0.05}) {
    for (double dy : {-0.05, 0.0, 0.05}) {
      for (double dz : {-0.1, -0.05, 0.0, 0.05, 0.1}) {
        const auto* node = octree.search(point.x() + dx, point.y() + dy, point.z() + dz);
        if (node && octree.isNodeOccupied(node)) return true;
      }
    }
  }
  return false;
}

// A lap of 70 m around a block, of which the LIDAR sees 8 m at a time.
TEST(Loops, AWayAroundABlockCloses) {
  const BoxRoom room = RingCorridor(24, 18, 2.5);
  DriveModel model{.duration_s = 85.0,
                   .rings = 16,
                   .columns = 240,
                   .range_noise_m = 0.015,
                   .odometry_scale = 0.97,
                   .odometry_yaw_scale = 0.97};
  model.path = [](double time_s) { return AlongRing(24, 18, 2.5, time_s); };
  auto mapper = Mapper::Create({.max_range_m = 8.0}, model.Calibration(), model.MapFromBase(0.0));
  ASSERT_TRUE(mapper.ok());
  AddAll(*mapper, SimulateDrive(room, model, 1));
  const auto result = mapper->Finish();
  ASSERT_TRUE(result.ok()) << result.status();
  const MappingReport& report = result->report;
  EXPECT_GE(report.loops_closed, 1);
  EXPECT_GT(report.drift_removed_m, 1.0);
  EXPECT_EQ(report.scans_unregistered, 0);
  EXPECT_LT(MaxError_m(report.path, model), 0.12);
  EXPECT_GT(NearSurfaces(*result->building.octree, room), 0.7);
}

// The same door every four metres: places look alike, and none is come back to.
TEST(Loops, RepeatedDoorsAreNotClosed) {
  std::vector<Box> posts;
  for (double at_m = 2.0; at_m < 58.0; at_m += 4.0) {
    for (const double y_m : {0.0, 2.35}) {
      posts.push_back({{at_m, y_m, 0.0}, {at_m + 0.2, y_m + 0.15, 2.1}});
      posts.push_back({{at_m + 1.1, y_m, 0.0}, {at_m + 1.3, y_m + 0.15, 2.1}});
    }
  }
  const BoxRoom room({60.0, 2.5, 2.5}, posts);
  DriveModel model{.duration_s = 50.0,
                   .lidar_period_s = 0.25,
                   .rings = 16,
                   .columns = 240,
                   .range_noise_m = 0.015,
                   .odometry_scale = 0.97,
                   .odometry_yaw_scale = 0.97};
  // There and back: what is far away by the way is near in space only where it is the same.
  model.path = [](double time_s) {
    return time_s < 24.0   ? Pose2{6.0 + 2.0 * time_s, 1.2, 0.0}
           : time_s < 26.0 ? Pose2{54.0, 1.2, (time_s - 24.0) * geometry::kPi / 2}
                           : Pose2{54.0 - 2.0 * (time_s - 26.0), 1.2, geometry::kPi};
  };
  auto mapper = Mapper::Create({.max_range_m = 8.0}, model.Calibration(), model.MapFromBase(0.0));
  ASSERT_TRUE(mapper.ok());
  AddAll(*mapper, SimulateDrive(room, model, 1));
  const auto result = mapper->Finish();
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->report.loops_closed, 0);
  EXPECT_LT(MaxError_m(result->report.path, model), 1.4);  // a false one would be 4 m off
}

struct SecondDrive {
  DriveModel model{.duration_s = 20.0,
                   .lap_s = 30.0,
                   .centre = {4.2, 3.0},
                   .radius = {2.6, 1.9},
                   .range_noise_m = 0.01,
                   .odometry_scale = 1.03,
                   .odometry_yaw_scale = 0.98,
                   // Another robot, whose LIDAR stands elsewhere.
                   .base_from_lidar = Eigen::Translation3d(-0.2, 0.0, 0.9) *
                                      Eigen::AngleAxisd(-2.0, Eigen::Vector3d::UnitZ())};
  TimeNs later_ns = -1'000'000'000'000;  // older
  std::vector<Frame> frames;
  explicit SecondDrive(const BoxRoom& room) {
    // The other way round.
    model.path = [](double time_s) {
      const double phase = 2.0 - 2 * geometry::kPi * time_s / 30.0;
      return Pose2{4.2 + 2.6 * std::cos(phase), 3.0 + 1.9 * std::sin(phase),
                   std::atan2(-1.9 * std::cos(phase), 2.6 * std::sin(phase))};
    };
    frames = Later(SimulateDrive(room, model, 2), later_ns);
  }
};

TEST(Drives, MergeWithAndWithoutAnInitialPose) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const DriveModel first{.duration_s = 20.0, .range_noise_m = 0.01, .odometry_scale = 0.97};
  const auto first_frames = SimulateDrive(room, first, 1);
  const SecondDrive second(room);
  Pose2 rough = second.model.MapFromBase(0.0);
  rough.x_m += 0.7;
  rough.y_m -= 0.5;
  rough.yaw_rad += 0.2;
  for (const std::optional<Pose2>& start : {std::optional<Pose2>(), std::optional(rough)}) {
    auto mapper = Mapper::Create({}, first.Calibration(), first.MapFromBase(0.0));
    ASSERT_TRUE(mapper.ok());
    AddAll(*mapper, first_frames);
    ASSERT_TRUE(mapper->BeginDrive(second.model.Calibration(), start).ok());
    AddAll(*mapper, second.frames);
    const auto result = mapper->Finish();
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->report.drive_begin.size(), 2u);
    EXPECT_LT(MaxError_m(PathOf(result->report, 0), first), 0.02);
    EXPECT_LT(MaxError_m(PathOf(result->report, 1), second.model, second.later_ns), 0.025);
    EXPECT_GT(NearSurfaces(*result->building.octree, room), 0.98);
  }
}

TEST(Drives, WithoutOverlapAreRefused) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const BoxRoom elsewhere(
      {5.0, 14.0, 3.0}, {{{1.0, 3.0, 0.0}, {2.0, 4.0, 2.0}}, {{3.0, 9.0, 0.0}, {5.0, 10.0, 1.0}}});
  const DriveModel first{.duration_s = 10.0};
  const DriveModel other{.duration_s = 10.0, .centre = {2.5, 6.5}, .radius = {1.2, 2.0}};
  for (const std::optional<Pose2>& start :
       {std::optional<Pose2>(), std::optional(other.MapFromBase(0.0))}) {
    auto mapper = Mapper::Create({}, first.Calibration(), first.MapFromBase(0.0));
    ASSERT_TRUE(mapper.ok());
    AddAll(*mapper, SimulateDrive(room, first, 1));
    ASSERT_TRUE(mapper->BeginDrive(other.Calibration(), start).ok());
    AddAll(*mapper, SimulateDrive(elsewhere, other, 1));
    const auto result = mapper->Finish();
    EXPECT_EQ(result.status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_THAT(std::string(result.status().message()), HasSubstr("drive 2 does not overlap"));
  }
}

TEST(Drives, ADriveWithoutScansIsNamed) {
  const DriveModel model{.duration_s = 5.0};
  auto mapper = Mapper::Create({}, model.Calibration(), {});
  ASSERT_TRUE(mapper.ok());
  AddAll(*mapper, SimulateDrive(BoxRoom::WithFurniture(), model, 1));
  frames::Calibration broken;
  broken.base_from_lidar.translation().x() = std::nan("");
  EXPECT_FALSE(mapper->BeginDrive(broken, std::nullopt).ok());
  EXPECT_FALSE(mapper->BeginDrive(model.Calibration(), Pose2{std::nan(""), 0, 0}).ok());
  ASSERT_TRUE(mapper->BeginDrive(model.Calibration(), std::nullopt).ok());
  const auto result = mapper->Finish();
  EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(result.status().message()), HasSubstr("drive 2 has no LIDAR"));
  EXPECT_FALSE(mapper->BeginDrive(model.Calibration(), std::nullopt).ok());
}

// The room as another program may have mapped it: voxels of another size, far from its origin.
building::Building ExactBuilding(const BoxRoom& room, double voxel_size_m,
                                 const Eigen::Vector3d& max) {
  auto octree = std::make_shared<octomap::OcTree>(voxel_size_m);
  for (double x = 0.5 * voxel_size_m - 0.4; x < max.x() + 0.4; x += voxel_size_m) {
    for (double y = 0.5 * voxel_size_m - 0.4; y < max.y() + 0.4; y += voxel_size_m) {
      for (double z = 0.5 * voxel_size_m - 0.4; z < max.z() + 0.4; z += voxel_size_m) {
        const double distance_m = room.SignedDistance({x, y, z});
        if (distance_m < -voxel_size_m) continue;  // inside of walls nothing is known
        octree->updateNode(
            octomap::point3d(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)),
            distance_m < 0.0, /*lazy_eval=*/true);
      }
    }
  }
  octree->updateInnerOccupancy();
  octree->prune();
  building::Building building;
  building.octree = octree;
  return building;
}

TEST(Extend, ANewDriveKeepsTheFrameAndAddsWhatIsNew) {
  const BoxRoom old_room = BoxRoom::WithFurniture();
  const auto building =
      std::make_shared<const building::Building>(ExactBuilding(old_room, 0.08, {8.0, 6.0, 2.5}));
  // A cupboard has come, and the low table has gone.
  const BoxRoom room({8.0, 6.0, 2.5}, {{{0.0, 0.0, 0.0}, {0.6, 2.0, 1.8}},
                                       {{6.5, 5.2, 0.0}, {8.0, 6.0, 1.1}},
                                       {{1.5, 5.4, 0.0}, {2.7, 6.0, 1.9}}});
  const SecondDrive drive(room);
  Pose2 rough = drive.model.MapFromBase(0.0);
  rough.x_m -= 0.8;
  rough.yaw_rad -= 0.2;
  for (const Pose2& start : {rough, Pose2{50.0, 50.0, 1.0}}) {  // the second is only found anywhere
    auto mapper = Mapper::Create({}, drive.model.Calibration(), start, {}, building);
    ASSERT_TRUE(mapper.ok()) << mapper.status();
    AddAll(*mapper, drive.frames);
    const auto result = mapper->Finish();
    ASSERT_TRUE(result.ok()) << result.status();
    // The old map's voxels are 8 cm wide.
    EXPECT_LT(MaxError_m(result->report.path, drive.model, drive.later_ns), 0.05);
    const octomap::OcTree& octree = *result->building.octree;
    EXPECT_NEAR(octree.getResolution(), 0.05, 1e-9);
    EXPECT_TRUE(OccupiedNear(octree, {2.0, 5.4, 1.0}));    // new
    EXPECT_FALSE(OccupiedNear(octree, {4.0, 2.45, 0.5}));  // gone
    EXPECT_TRUE(OccupiedNear(octree, {0.6, 1.0, 1.0}));    // as before
  }
}

TEST(Extend, ADriveElsewhereIsRefused) {
  const auto building = std::make_shared<const building::Building>(
      ExactBuilding(BoxRoom::WithFurniture(), 0.1, {8.0, 6.0, 2.5}));
  const BoxRoom elsewhere({5.0, 14.0, 3.0}, {{{1.0, 3.0, 0.0}, {2.0, 4.0, 2.0}}});
  const DriveModel other{.duration_s = 8.0, .centre = {2.5, 6.5}, .radius = {1.2, 2.0}};
  auto mapper = Mapper::Create({}, other.Calibration(), other.MapFromBase(0.0), {}, building);
  ASSERT_TRUE(mapper.ok());
  AddAll(*mapper, SimulateDrive(elsewhere, other, 1));
  const auto result = mapper->Finish();
  EXPECT_EQ(result.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(result.status().message()), HasSubstr("extend"));
  EXPECT_FALSE(
      Mapper::Create({}, other.Calibration(), {}, {}, std::make_shared<const building::Building>())
          .ok());
}

// Odometry as real robots send it.
TEST(BadOdometry, IsSurvived) {
  const BoxRoom room = BoxRoom::WithFurniture();
  DriveModel model{.duration_s = 16.0, .lidar_period_s = 0.2, .range_noise_m = 0.01};
  // Forward, and backward on the same way.
  model.path = [](double time_s) {
    const double at = time_s < 8.0 ? time_s : 16.0 - time_s;
    return Pose2{1.5 + 0.5 * at, 1.3 + 0.05 * at, 0.1};
  };
  const auto drive = SimulateDrive(room, model, 1);
  const auto error_m = [&](auto change) {
    auto mapper = Mapper::Create({}, model.Calibration(), model.MapFromBase(0.0)).value();
    Pose2 last, told;
    std::optional<frames::Odometry> before;
    for (Frame frame : drive) {
      if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
        Pose2 step = last.Inverse() * odometry->odom_from_base;
        last = odometry->odom_from_base;
        told = told * change(frames::SecondsFromNs(odometry->stamp_ns - kDriveStart_ns), step);
        odometry->odom_from_base = told;
        if (before) {  // repeated
          EXPECT_TRUE(mapper.Add(*before).ok());
        }
        before = *odometry;
      }
      EXPECT_TRUE(mapper.Add(frame).ok());
    }
    const auto result = mapper.Finish();
    EXPECT_TRUE(result.ok()) << result.status();
    return result.ok() ? MaxError_m(result->report.path, model) : 1e9;
  };
  EXPECT_LT(error_m([](double, const Pose2& step) { return step; }), 0.01);
  // Never reverse.
  EXPECT_LT(error_m([](double, Pose2 step) {
              step.x_m = std::abs(step.x_m);
              return step;
            }),
            0.12);
  // Stands still for three seconds in the middle.
  EXPECT_LT(error_m([](double time_s, const Pose2& step) {
              return time_s > 5.0 && time_s < 8.0 ? Pose2{} : step;
            }),
            0.04);
  // Jumps by a metre and by a radian.
  EXPECT_LT(error_m([](double time_s, const Pose2& step) {
              return std::abs(time_s - 6.0) < 0.01 ? Pose2{1.0, 0.5, 1.0} : step;
            }),
            0.03);
}

TEST(People, WhoWalkThroughAreNotInTheMap) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const Walker walkers[] = {{{1.2, 4.8}, {6.0, 4.6}, 11.0}, {{6.8, 0.8}, {6.2, 4.4}, 7.0}};
  DriveModel model{.duration_s = 40.0, .lidar_period_s = 0.4, .range_noise_m = 0.01};
  model.moving = [&](double time_s, const Eigen::Vector3d& origin,
                     const Eigen::Vector3d& direction) {
    return std::min(DistanceToWalker(walkers[0], time_s, origin, direction),
                    DistanceToWalker(walkers[1], time_s, origin, direction));
  };
  auto mapper = Mapper::Create({}, model.Calibration(), model.MapFromBase(0.0));
  ASSERT_TRUE(mapper.ok());
  AddAll(*mapper, SimulateDrive(room, model, 1));
  const auto result = mapper->Finish();
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(MaxError_m(result->report.path, model), 0.012);
  octomap::OcTree leaves(*result->building.octree);
  leaves.expand();
  int left = 0;
  for (auto leaf = leaves.begin_leafs(); leaf != leaves.end_leafs(); ++leaf) {
    if (!leaves.isNodeOccupied(*leaf) ||
        room.SignedDistance({leaf.getX(), leaf.getY(), leaf.getZ()}) <= 0.1) {
      continue;
    }
    ++left;
    ADD_FAILURE() << leaf.getX() << ' ' << leaf.getY() << ' ' << leaf.getZ();
  }
  EXPECT_EQ(left, 0);
}

}  // namespace
}  // namespace soundmap::mapping
