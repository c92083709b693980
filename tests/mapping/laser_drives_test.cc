// Several drives of an LRF through one building, and drives that extend a map.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "mapping/floor_plan_mapper.h"
#include "tests/mapping/laser_world.h"

namespace soundmap::mapping {
namespace {

using building::Cell;
using building::FloorPlan;
using geometry::Pose2;
using ::testing::HasSubstr;

// Rooms of different sizes on both sides of a corridor from (0, 0) to (24, 2), with doors to it.
LaserWorld Floor() {
  LaserWorld world;
  world.AddWall({0, 0}, {0, 2});
  world.AddWall({24, 0}, {24, 2});
  const auto wall_with_doors = [&world](double y_m, std::vector<double> doors_x_m) {
    double from_m = 0.0;
    for (const double door_m : doors_x_m) {
      world.AddWall({from_m, y_m}, {door_m, y_m});
      from_m = door_m + 1.0;
    }
    world.AddWall({from_m, y_m}, {24, y_m});
  };
  wall_with_doors(0.0, {2.0, 9.5, 19.0});
  wall_with_doors(2.0, {5.0, 14.0, 21.0});
  world.AddWall({0, -4}, {24, -4});
  for (const double x_m : {0.0, 6.5, 15.0, 24.0}) world.AddWall({x_m, -4}, {x_m, 0});
  world.AddWall({0, 7}, {24, 7});
  for (const double x_m : {0.0, 9.0, 17.5, 24.0}) world.AddWall({x_m, 2}, {x_m, 7});
  world.AddBox({3.0, 4.5}, {4.2, 5.5});
  world.AddBox({11.0, 5.8}, {13.5, 7.0});
  world.AddBox({19.5, 3.8}, {20.3, 6.0});
  world.AddBox({1.0, -3.2}, {1.6, -1.5});
  world.AddBox({11.5, -2.8}, {13.0, -2.0});
  return world;
}

LaserDriveModel Driven(std::vector<Eigen::Vector2d> corners) {
  LaserDriveModel model;
  model.corners = std::move(corners);
  model.speed_mps = 0.8;
  model.max_range_m = 12.0;
  model.odometry_scale = 0.02;
  model.odometry_turn_radpm = 0.005;
  return model;
}

// The western part and the eastern one; both know the rooms in the middle.
SimulatedLaserDrive West() {
  return SimulateLaserDrive(Floor(),
                            Driven({{1, 1},
                                    {5.5, 1},
                                    {5.5, 4},
                                    {7, 4},
                                    {5.5, 4},
                                    {5.5, 1},
                                    {10, 1},
                                    {10, -2},
                                    {8, -2},
                                    {10, -2},
                                    {10, 1},
                                    {14.5, 1},
                                    {14.5, 4.5},
                                    {11, 4.5},
                                    {14.5, 4.5},
                                    {14.5, 1},
                                    {12, 1}}),
                            3);
}
SimulatedLaserDrive East() {
  return SimulateLaserDrive(Floor(),
                            Driven({{10, -2},
                                    {10, 1},
                                    {14.5, 1},
                                    {14.5, 4.5},
                                    {11, 4.5},
                                    {14.5, 4.5},
                                    {14.5, 1},
                                    {21.5, 1},
                                    {21.5, 4.5},
                                    {21.5, 1},
                                    {19.5, 1},
                                    {19.5, -2},
                                    {22, -2},
                                    {19.5, -2},
                                    {19.5, 1}}),
                            4);
}
SimulatedLaserDrive Elsewhere() {
  LaserDriveModel model = Driven({{2, 2}, {7, 2}, {7, 5}, {2.5, 5}, {2, 2}, {7, 2}});
  return SimulateLaserDrive(FurnishedHall(), model, 5);
}

absl::Status AddAll(const SimulatedLaserDrive& drive, FloorPlanMapper& mapper) {
  for (const frames::Frame& frame : drive.frames) {
    if (const absl::Status status = mapper.Add(frame); !status.ok()) return status;
  }
  return absl::OkStatus();
}

absl::StatusOr<FloorPlanResult> Map(const std::vector<SimulatedLaserDrive>& drives,
                                    std::optional<Pose2> start_of_first,
                                    std::shared_ptr<const building::Building> extend = nullptr) {
  auto mapper = FloorPlanMapper::Create({}, drives.front().calibration,
                                        start_of_first.value_or(Pose2{}), {}, std::move(extend));
  if (!mapper.ok()) return mapper.status();
  for (const SimulatedLaserDrive& drive : drives) {
    if (&drive != &drives.front()) {
      const absl::Status begun = mapper->BeginDrive(drive.calibration, std::nullopt);
      if (!begun.ok()) return begun;
    }
    if (const absl::Status status = AddAll(drive, *mapper); !status.ok()) return status;
  }
  return mapper->Finish();
}

// Of a part of a path from the truth, in the map.
double MaxError_m(const FloorPlanReport& report, std::size_t drive,
                  const std::vector<StampedPose>& truth) {
  double max_m = 0.0;
  std::size_t next = 0;
  const std::size_t end =
      drive + 1 < report.drive_begin.size() ? report.drive_begin[drive + 1] : report.path.size();
  for (std::size_t i = report.drive_begin[drive]; i < end; ++i) {
    while (next < truth.size() && truth[next].stamp_ns < report.path[i].stamp_ns) ++next;
    if (next == truth.size()) return INFINITY;
    const Pose2 off = truth[next].map_from_base.Inverse() * report.path[i].map_from_base;
    max_m = std::max(max_m, std::hypot(off.x_m, off.y_m));
  }
  return max_m;
}

// Share of the occupied cells that lie further than two cells from any wall.
double GhostShare(const FloorPlan& plan, const LaserWorld& world) {
  int occupied = 0, ghosts = 0;
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      if (plan.at(column, row) != Cell::kOccupied) continue;
      ++occupied;
      const Eigen::Vector2d centre =
          plan.origin_in_map_m() + plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
      ghosts += world.DistanceToWall(centre) > 2.0 * plan.cell_size_m();
    }
  }
  return static_cast<double>(ghosts) / occupied;
}

Cell At(const FloorPlan& plan, double x_m, double y_m) {
  const Eigen::Vector2d cell =
      (Eigen::Vector2d(x_m, y_m) - plan.origin_in_map_m()) / plan.cell_size_m();
  const int column = static_cast<int>(std::floor(cell.x())),
            row = static_cast<int>(std::floor(cell.y()));
  return plan.Contains(column, row) ? plan.at(column, row) : Cell::kUnknown;
}

TEST(LaserDrives, MergeWhereverTheOdometryBegan) {
  const SimulatedLaserDrive west = West(), east = East();
  const auto result = Map({west, east}, west.start);
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_EQ(result->report.drive_begin.size(), 2u);
  EXPECT_LT(MaxError_m(result->report, 0, west.truth), 0.05);
  EXPECT_LT(MaxError_m(result->report, 1, east.truth), 0.05);
  const FloorPlan& plan = result->building.floor_plan;
  EXPECT_LT(GhostShare(plan, Floor()), 0.02);
  EXPECT_EQ(At(plan, 1.0, 1.0), Cell::kFree);   // the west's alone
  EXPECT_EQ(At(plan, 21.5, 3.0), Cell::kFree);  // the east's alone
  EXPECT_EQ(At(plan, 30.0, 1.0), Cell::kUnknown);
}

TEST(LaserDrives, AThirdMayReachOnlyTheSecond) {
  const SimulatedLaserDrive west = West(), east = East();
  const SimulatedLaserDrive far_east = SimulateLaserDrive(
      Floor(),
      Driven({{22, 1}, {21.5, 1}, {21.5, 4.5}, {21.5, 1}, {19.5, 1}, {19.5, -2}, {22, -2}}), 6);
  const auto result = Map({west, far_east, east}, west.start);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(MaxError_m(result->report, 1, far_east.truth), 0.05);
  EXPECT_LT(MaxError_m(result->report, 2, east.truth), 0.05);
}

TEST(LaserDrives, ExtendAMapWhoseFrameAndWallsStay) {
  const SimulatedLaserDrive west = West(), east = East();
  const auto old_map = Map({west}, west.start);
  ASSERT_TRUE(old_map.ok()) << old_map.status();
  // A ROS map's cells lie anywhere.
  const FloorPlan& drawn = old_map->building.floor_plan;
  auto old_building = std::make_shared<building::Building>();
  const Eigen::Vector2d off_m(-3.017, 8.031);
  old_building->floor_plan = FloorPlan(drawn.width(), drawn.height(), drawn.cell_size_m(),
                                       drawn.origin_in_map_m() + off_m);
  FloorPlan& old_plan = old_building->floor_plan;
  for (int row = 0; row < drawn.height(); ++row) {
    for (int column = 0; column < drawn.width(); ++column) {
      old_plan.at(column, row) = drawn.at(column, row);
    }
  }
  const auto result = Map({east}, std::nullopt, old_building);
  ASSERT_TRUE(result.ok()) << result.status();
  std::vector<StampedPose> truth = east.truth;
  for (StampedPose& pose : truth) {
    pose.map_from_base.x_m += off_m.x();
    pose.map_from_base.y_m += off_m.y();
  }
  EXPECT_LT(MaxError_m(result->report, 0, truth), 0.06);
  const FloorPlan& plan = result->building.floor_plan;
  EXPECT_EQ(At(plan, 21.5 + off_m.x(), 3.0 + off_m.y()), Cell::kFree);
  // Cell upon cell: the origins differ by whole cells, and what only the west saw is as it was.
  const Eigen::Vector2d cells =
      (old_plan.origin_in_map_m() - plan.origin_in_map_m()) / plan.cell_size_m();
  EXPECT_NEAR(cells.x(), std::round(cells.x()), 1e-6);
  EXPECT_NEAR(cells.y(), std::round(cells.y()), 1e-6);
  int known = 0, changed = 0, occupied = 0, still_occupied = 0;
  for (int row = 0; row < old_plan.height(); ++row) {
    for (int column = 0; column < old_plan.width(); ++column) {
      const Cell before = old_plan.at(column, row);
      if (before == Cell::kUnknown) continue;
      const Eigen::Vector2d centre =
          old_plan.origin_in_map_m() +
          old_plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
      const Cell after = At(plan, centre.x(), centre.y());
      occupied += before == Cell::kOccupied;
      still_occupied += before == Cell::kOccupied && after == Cell::kOccupied;
      if (centre.x() - off_m.x() > 5.0) continue;
      ++known;
      changed += before != after;
    }
  }
  EXPECT_GT(known, 1000);
  EXPECT_LE(changed, known / 500);
  EXPECT_GT(still_occupied, 0.9 * occupied);
}

TEST(LaserDrives, ThatDoNotOverlapAreRefused) {
  const SimulatedLaserDrive west = West(), elsewhere = Elsewhere();
  const auto two = Map({west, elsewhere}, west.start);
  ASSERT_EQ(two.status().code(), absl::StatusCode::kFailedPrecondition) << two.status();
  EXPECT_THAT(std::string(two.status().message()), HasSubstr("drive 2 does not overlap"));
  const auto old_map = Map({west}, west.start);
  ASSERT_TRUE(old_map.ok());
  const auto extended =
      Map({elsewhere}, std::nullopt, std::make_shared<const building::Building>(old_map->building));
  ASSERT_EQ(extended.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(extended.status().message()), HasSubstr("that it is to extend"));
}

// Nothing tells where along it the second was.
TEST(LaserDrives, ABareCorridorIsNoPlaceToMeet) {
  LaserWorld world;
  world.AddWall({-100, -1}, {100, -1});
  world.AddWall({-100, 1}, {100, 1});
  const auto first = SimulateLaserDrive(world, Driven({{0, 0}, {15, 0}}), 1);
  const auto second = SimulateLaserDrive(world, Driven({{3, 0}, {18, 0}}), 2);
  const auto result = Map({first, second}, first.start);
  EXPECT_EQ(result.status().code(), absl::StatusCode::kFailedPrecondition) << result.status();
}

TEST(LaserDrives, EachMustHaveSomethingToMap) {
  const SimulatedLaserDrive hall = Elsewhere();
  auto mapper = FloorPlanMapper::Create({}, hall.calibration, hall.start);
  ASSERT_TRUE(mapper.ok());
  ASSERT_TRUE(AddAll(hall, *mapper).ok());
  EXPECT_FALSE(mapper->BeginDrive(hall.calibration, Pose2{NAN, 0, 0}).ok());
  ASSERT_TRUE(mapper->BeginDrive(hall.calibration, std::nullopt).ok());
  const auto result = mapper->Finish();
  EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(result.status().message()), HasSubstr("drive 2"));
  auto surveyed = FloorPlanMapper::Create({}, hall.calibration, hall.start,
                                          {{1'000'000'000, {}}, {2'000'000'000, {}}});
  ASSERT_TRUE(surveyed.ok());
  EXPECT_FALSE(surveyed->BeginDrive(hall.calibration, std::nullopt).ok());
}

}  // namespace
}  // namespace soundmap::mapping
