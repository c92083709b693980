#include "mapping/floor_plan_mapper.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/angles.h"
#include "tests/mapping/laser_drive.h"
#include "tests/mapping/laser_world.h"

namespace soundmap::mapping {
namespace {

using building::Cell;
using building::FloorPlan;
using geometry::Pose2;
using ::testing::HasSubstr;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

absl::StatusOr<FloorPlanResult> Map(const SimulatedLaserDrive& drive,
                                    const FloorPlanMapperConfig& config = {},
                                    std::vector<StampedPose> surveyed = {}) {
  auto mapper =
      FloorPlanMapper::Create(config, drive.calibration, drive.start, std::move(surveyed));
  if (!mapper.ok()) return mapper.status();
  for (const frames::Frame& frame : drive.frames) {
    if (const absl::Status status = mapper->Add(frame); !status.ok()) return status;
  }
  return mapper->Finish();
}

// Largest distance and mean turn of the path from the truth, in the map's own frame.
struct Deviation {
  double max_m = 0.0;
  double mean_rad = 0.0;
};
Deviation DeviationOf(const std::vector<StampedPose>& path, const std::vector<StampedPose>& truth) {
  Deviation deviation;
  std::size_t next = 0;
  for (const StampedPose& pose : path) {
    while (next < truth.size() && truth[next].stamp_ns < pose.stamp_ns) ++next;
    if (next == truth.size() || truth[next].stamp_ns != pose.stamp_ns) {
      ADD_FAILURE() << "a pose at a time at which no scan was taken";
      return deviation;
    }
    const Pose2 off = truth[next].map_from_base.Inverse() * pose.map_from_base;
    deviation.max_m = std::max(deviation.max_m, std::hypot(off.x_m, off.y_m));
    deviation.mean_rad += std::abs(off.yaw_rad) / static_cast<double>(path.size());
  }
  return deviation;
}

// Shares of the occupied cells further than this from any wall, and of the free ones nearer than
// that to one from the wrong side: free cells may not lie beyond walls, so only those on them
// count.
struct PlanFaults {
  int occupied = 0;
  int ghosts = 0;  // occupied, but no wall within two cells
  int free = 0;
};
PlanFaults FaultsOf(const FloorPlan& plan, const LaserWorld& world) {
  PlanFaults faults;
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      const Eigen::Vector2d centre =
          plan.origin_in_map_m() + plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
      if (plan.at(column, row) == Cell::kFree) ++faults.free;
      if (plan.at(column, row) != Cell::kOccupied) continue;
      ++faults.occupied;
      if (world.DistanceToWall(centre) > 2.0 * plan.cell_size_m()) ++faults.ghosts;
    }
  }
  return faults;
}

Cell At(const FloorPlan& plan, double x_m, double y_m) {
  const Eigen::Vector2d cell =
      (Eigen::Vector2d(x_m, y_m) - plan.origin_in_map_m()) / plan.cell_size_m();
  const int column = static_cast<int>(std::floor(cell.x())),
            row = static_cast<int>(std::floor(cell.y()));
  return plan.Contains(column, row) ? plan.at(column, row) : Cell::kUnknown;
}

LaserDriveModel InTheHall() {
  LaserDriveModel model;
  model.corners = {{2, 2}, {7, 2}, {7, 5}, {2.5, 5}, {2, 2}};
  return model;
}

LaserDriveModel AroundTheBlock() {
  LaserDriveModel model;
  model.corners = {{1, 1}, {29, 1}, {29, 19}, {1, 19}, {1, 1}, {8, 1}};
  model.speed_mps = 1.0;
  model.scan_rate_hz = 8.0;
  return model;
}

TEST(FloorPlanMapper, AHallIsDrawnAsItIs) {
  LaserDriveModel model = InTheHall();
  model.odometry_scale = 0.03;
  model.odometry_turn_radpm = 0.01;
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 1);
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->building.octree, nullptr);
  EXPECT_EQ(result->report.scans, static_cast<int>(drive.truth.size()));
  EXPECT_EQ(result->report.scans_dropped, 0);
  EXPECT_EQ(result->report.scans_unregistered, 0);
  EXPECT_EQ(result->report.path.size(), drive.truth.size());
  const Deviation deviation = DeviationOf(result->report.path, drive.truth);
  EXPECT_LT(deviation.max_m, 0.03);
  EXPECT_LT(deviation.mean_rad, 0.004);
  EXPECT_GT(result->report.drift_removed_m, 0.1);

  const FloorPlan& plan = result->building.floor_plan;
  EXPECT_EQ(plan.cell_size_m(), 0.05);
  const PlanFaults faults = FaultsOf(plan, FurnishedHall());
  EXPECT_GT(faults.occupied, 500);
  EXPECT_EQ(faults.ghosts, 0);
  EXPECT_GT(faults.free, 20000);                    // of 63 m2, 25200 cells, less the furniture
  EXPECT_EQ(At(plan, 4.45, 3.45), Cell::kUnknown);  // inside the pillar
  EXPECT_EQ(At(plan, 8.5, 1.2), Cell::kUnknown);    // inside the cupboard
  EXPECT_EQ(At(plan, 3.0, 3.0), Cell::kFree);
  // Every stretch of the cupboard's front is seen.
  for (double y = 0.1; y < 2.4; y += 0.05) {
    EXPECT_TRUE(At(plan, 8.02, y) == Cell::kOccupied || At(plan, 7.98, y) == Cell::kOccupied) << y;
  }
}

TEST(FloorPlanMapper, TheSameDriveGivesTheSamePlan) {
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), InTheHall(), 2);
  const auto one = Map(drive), other = Map(drive);
  ASSERT_TRUE(one.ok() && other.ok());
  EXPECT_EQ(one->building.floor_plan, other->building.floor_plan);
  EXPECT_EQ(one->report.path, other->report.path);
}

TEST(FloorPlanMapper, ALongLoopWithDriftingOdometryCloses) {
  LaserDriveModel model = AroundTheBlock();
  model.odometry_scale = -0.03;
  model.odometry_turn_radpm = 0.01;
  const SimulatedLaserDrive drive = SimulateLaserDrive(CorridorsAroundABlock(), model, 3);
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_GE(result->report.loops_closed, 1);
  EXPECT_GT(result->report.drift_removed_m, 2.0);
  // The end of the path is where the way has been before.
  const Pose2 off =
      drive.truth.back().map_from_base.Inverse() * result->report.path.back().map_from_base;
  EXPECT_LT(std::hypot(off.x_m, off.y_m), 0.05);
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.12);
  const PlanFaults faults = FaultsOf(result->building.floor_plan, CorridorsAroundABlock());
  EXPECT_LT(faults.ghosts, faults.occupied / 20);
}

// That the loop is closed by looking for it, and not by luck.
TEST(FloorPlanMapper, WithoutLookingForLoopsItStaysOpen) {
  LaserDriveModel model = AroundTheBlock();
  model.odometry_scale = -0.03;
  model.odometry_turn_radpm = 0.01;
  model.range_noise_m = 0.03;
  model.beams = 61;
  model.max_range_m = 6.0;
  const SimulatedLaserDrive drive = SimulateLaserDrive(CorridorsAroundABlock(), model, 3);
  FloorPlanMapperConfig config;
  const auto closed = Map(drive, config);
  config.stretch_m = 50.0;  // too long to come back to
  config.relaxation_passes = 0;
  const auto open = Map(drive, config);
  ASSERT_TRUE(closed.ok() && open.ok());
  EXPECT_GE(closed->report.loops_closed, 1);
  EXPECT_EQ(open->report.loops_closed, 0);
  // Against where the same corridor was seen at first.
  const auto end_error_m = [&drive](const FloorPlanReport& report) {
    const Pose2 off = drive.truth.back().map_from_base.Inverse() * report.path.back().map_from_base;
    return std::hypot(off.x_m, off.y_m);
  };
  EXPECT_LT(end_error_m(closed->report), 0.1);
  EXPECT_GT(end_error_m(open->report), 0.2);
}

TEST(FloorPlanMapper, AFeaturelessCorridorDoesNotCollapse) {
  LaserWorld world;
  world.AddWall({-100, -1}, {100, -1});
  world.AddWall({-100, 1}, {100, 1});
  LaserDriveModel model;
  model.corners = {{0, 0}, {30, 0}};
  model.max_range_m = 8.0;
  const SimulatedLaserDrive drive = SimulateLaserDrive(world, model, 4);
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  const Pose2& end = result->report.path.back().map_from_base;
  EXPECT_NEAR(end.x_m, drive.truth.back().map_from_base.x_m, 0.3);  // 1 % of the way
  EXPECT_NEAR(end.y_m, 0.0, 0.05);
}

TEST(FloorPlanMapper, ScansWithoutAReturnAreLeftOut) {
  SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), InTheHall(), 5);
  int blinded = 0, count = 0;
  for (frames::Frame& frame : drive.frames) {
    auto* scan = std::get_if<frames::LaserScan>(&frame);
    if (!scan || count++ % 3 != 1) continue;
    std::fill(scan->range_m.begin(), scan->range_m.end(), kNan);
    ++blinded;
  }
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->report.scans_dropped, blinded);
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.03);

  for (frames::Frame& frame : drive.frames) {
    if (auto* scan = std::get_if<frames::LaserScan>(&frame)) {
      std::fill(scan->range_m.begin(), scan->range_m.end(), kNan);
    }
  }
  const absl::Status nothing = Map(drive).status();
  EXPECT_TRUE(absl::IsInvalidArgument(nothing));
  EXPECT_THAT(std::string(nothing.message()), HasSubstr("has a return"));
}

TEST(FloorPlanMapper, OdometryThatJumpsIsSurvived) {
  LaserDriveModel model = InTheHall();
  model.spoil = [](double time_s, const Pose2& odom_from_base) {
    return time_s < 12.0 ? odom_from_base : Pose2{40.0, -7.0, 2.0} * odom_from_base;
  };
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 6);
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.05);
}

TEST(FloorPlanMapper, OdometryThatStopsAndCatchesUpIsSurvived) {
  LaserDriveModel model = InTheHall();
  Pose2 held;
  model.spoil = [&held](double time_s, const Pose2& odom_from_base) {
    if (std::fmod(time_s, 4.0) < 3.2) held = odom_from_base;  // silent for 0.8 s in 4
    return held;
  };
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 7);
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.05);
}

// Odometry that knows no backward motion: it stands while the robot goes back.
TEST(FloorPlanMapper, OdometryThatNeverReportsReverseIsSurvived) {
  LaserDriveModel model;
  model.corners = {{2, 2}, {6, 2}};
  SimulatedLaserDrive forth = SimulateLaserDrive(FurnishedHall(), model, 8);
  // The way back in the same heading: the scans of the way there in reverse order.
  SimulatedLaserDrive drive = forth;
  const frames::TimeNs end_ns =
      std::max(frames::StampOf(forth.frames.back()), forth.truth.back().stamp_ns);
  const frames::Odometry last = [&] {
    for (auto frame = forth.frames.rbegin();; ++frame) {
      if (const auto* odometry = std::get_if<frames::Odometry>(&*frame)) return *odometry;
    }
  }();
  for (auto frame = forth.frames.rbegin(); frame != forth.frames.rend(); ++frame) {
    const frames::TimeNs stamp_ns = 2 * end_ns - frames::StampOf(*frame) + 1'000'000;
    if (const auto* scan = std::get_if<frames::LaserScan>(&*frame)) {
      frames::LaserScan back = *scan;
      back.stamp_ns = stamp_ns;
      drive.frames.emplace_back(std::move(back));
    } else {
      drive.frames.emplace_back(frames::Odometry{stamp_ns, last.odom_from_base});
    }
  }
  for (auto pose = forth.truth.rbegin(); pose != forth.truth.rend(); ++pose) {
    drive.truth.push_back({2 * end_ns - pose->stamp_ns + 1'000'000, pose->map_from_base});
  }
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.05);
}

TEST(FloorPlanMapper, RepeatedAndBackwardFramesAreLeftOut) {
  SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), InTheHall(), 9);
  const auto expected = Map(drive);
  std::vector<frames::Frame> frames;
  int repeated_scans = 0;
  for (std::size_t i = 0; i < drive.frames.size(); ++i) {
    frames.push_back(drive.frames[i]);
    if (i % 7 == 3) frames.push_back(drive.frames[i]);
    if (i % 7 == 3 && std::holds_alternative<frames::LaserScan>(drive.frames[i])) ++repeated_scans;
  }
  drive.frames = frames;
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok() && expected.ok());
  EXPECT_GT(repeated_scans, 5);
  EXPECT_EQ(result->report.scans_dropped, repeated_scans);
  EXPECT_EQ(result->report.path, expected->report.path);
}

TEST(FloorPlanMapper, SweptScansAreStraightened) {
  LaserDriveModel model = InTheHall();
  model.turn_rate_radps = 1.0;
  model.beams = 361;
  model.field_of_view_rad = 1.5 * geometry::kPi;
  model.time_increment_s = 0.09 / 361;  // almost the whole period
  const SimulatedLaserDrive swept = SimulateLaserDrive(FurnishedHall(), model, 10);
  const auto straightened = Map(swept);
  SimulatedLaserDrive untold = swept;
  untold.calibration.laser_time_increment_s = 0.0;
  for (StampedPose& pose : untold.truth) pose.stamp_ns -= 45'000'000 - 125'000;
  const auto bent = Map(untold);
  ASSERT_TRUE(straightened.ok() && bent.ok());
  EXPECT_LT(DeviationOf(straightened->report.path, swept.truth).max_m, 0.03);
  const PlanFaults good = FaultsOf(straightened->building.floor_plan, FurnishedHall());
  const PlanFaults bad = FaultsOf(bent->building.floor_plan, FurnishedHall());
  EXPECT_EQ(good.ghosts, 0);
  EXPECT_GT(bad.ghosts, 10);
}

TEST(FloorPlanMapper, ALagOfTheScansIsAllowedFor) {
  LaserDriveModel model = InTheHall();
  model.lag_s = 0.2;
  model.turn_rate_radps = 1.2;
  model.range_noise_m = 0.02;
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 11);
  FloorPlanMapperConfig config;
  config.laser_lag_s = 0.2;
  const auto allowed_for = Map(drive, config);
  ASSERT_TRUE(allowed_for.ok());
  EXPECT_EQ(allowed_for->report.laser_lag_s, 0.2);
  EXPECT_LT(DeviationOf(allowed_for->report.path, drive.truth).max_m, 0.03);
}

TEST(FloorPlanMapper, TellsTheLagOfTheScansFromTheTurns) {
  for (const double lag_s : {-0.05, 0.0, 0.12, 0.25}) {
    LaserDriveModel model = InTheHall();
    model.corners.insert(model.corners.end(), {{7, 2}, {7, 5}, {2.5, 5}, {2, 2}});
    model.lag_s = lag_s;
    const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 11);
    const auto result = Map(drive);
    ASSERT_TRUE(result.ok());
    EXPECT_NEAR(result->report.laser_lag_s, lag_s, 0.02);
    // The first scan is placed before anything is known of the lag.
    EXPECT_LT(ErrorOfPath(result->report.path, drive.truth).max_m, 0.04);
  }
}

TEST(FloorPlanMapper, PeopleWhoWalkByAreForgotten) {
  LaserDriveModel model = InTheHall();
  // Two people of 0.4 m across on their ways through the hall.
  const auto person = [](const Eigen::Vector2d& place, const Eigen::Vector2d& origin,
                         double angle) {
    const Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
    const double along = (place - origin).dot(direction);
    const double across2 = (place - origin).squaredNorm() - along * along;
    return along > 0.2 && across2 < 0.04 ? along - std::sqrt(0.04 - across2)
                                         : std::numeric_limits<double>::infinity();
  };
  model.visitor = [&person](double time_s, const Eigen::Vector2d& origin, double angle) {
    const double u = 0.5 + 0.5 * std::sin(0.3 * time_s),
                 v = 0.5 + 0.5 * std::sin(0.23 * time_s + 1);
    return std::min(person({1.0 + 6.5 * u, 6.2}, origin, angle),
                    person({5.8, 0.8 + 5.4 * v}, origin, angle));
  };
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 12);
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.04);
  const PlanFaults faults = FaultsOf(result->building.floor_plan, FurnishedHall());
  EXPECT_LE(faults.ghosts, 15);  // where one stood last, and no ray came after
}

TEST(FloorPlanMapper, SurveyedPosesAreKept) {
  LaserDriveModel model = AroundTheBlock();
  model.odometry_scale = 0.05;
  model.odometry_turn_radpm = 0.02;
  const SimulatedLaserDrive drive = SimulateLaserDrive(CorridorsAroundABlock(), model, 13);
  // Every 4 s, in a frame that the drive knows nothing of, from 10 s on.
  const Pose2 survey_from_map{100.0, -50.0, 1.0};
  std::vector<StampedPose> surveyed, truth;
  for (std::size_t i = 0; i < drive.truth.size(); ++i) {
    truth.push_back({drive.truth[i].stamp_ns, survey_from_map * drive.truth[i].map_from_base});
    if (i >= 80 && i % 32 == 16) surveyed.push_back(truth.back());
  }
  const auto result = Map(drive, {}, surveyed);
  ASSERT_TRUE(result.ok()) << result.status();
  const auto& path = result->report.path;
  EXPECT_EQ(path.front().stamp_ns, surveyed.front().stamp_ns);
  EXPECT_EQ(path.back().stamp_ns, surveyed.back().stamp_ns);
  EXPECT_EQ(result->report.scans_dropped, static_cast<int>(drive.truth.size() - path.size()));
  EXPECT_LT(DeviationOf(path, truth).max_m, 0.05);
  std::size_t next = 0;
  for (const StampedPose& pose : path) {
    if (next < surveyed.size() && pose.stamp_ns == surveyed[next].stamp_ns) {
      EXPECT_EQ(pose, surveyed[next++]);
    }
  }
  EXPECT_EQ(next, surveyed.size());

  for (StampedPose& pose : surveyed) pose.stamp_ns += frames::NsFromSeconds(1e6);
  EXPECT_THAT(std::string(Map(drive, {}, surveyed).status().message()),
              HasSubstr("between two of the surveyed poses"));
}

TEST(FloorPlanMapper, AnLrfThatHangsUpsideDownSeesTheSame) {
  LaserDriveModel model = InTheHall();
  model.base_from_laser = Eigen::Translation3d(-0.2, 0.1, 0.8) *
                          Eigen::AngleAxisd(geometry::kPi, Eigen::Vector3d::UnitX());
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 14);
  const auto result = Map(drive);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.03);
  EXPECT_EQ(FaultsOf(result->building.floor_plan, FurnishedHall()).ghosts, 0);
}

TEST(FloorPlanMapper, ATiltedLrfIsRefused) {
  frames::Calibration calibration;
  calibration.base_from_laser.linear() =
      Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitY()).toRotationMatrix();
  const absl::Status status = FloorPlanMapper::Create({}, calibration, {}).status();
  EXPECT_THAT(std::string(status.message()), HasSubstr("tilted by 29 degrees"));
}

TEST(FloorPlanMapper, CanBeCancelledAndFinishesOnce) {
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), InTheHall(), 15);
  for (const double limit : {0.0, 0.65, 0.9}) {
    auto mapper = FloorPlanMapper::Create({}, drive.calibration, drive.start);
    ASSERT_TRUE(mapper.ok());
    for (const frames::Frame& frame : drive.frames) ASSERT_TRUE(mapper->Add(frame).ok());
    double last = 0.0;
    const auto result = mapper->Finish([&](double done) {
      EXPECT_GE(done, last);
      EXPECT_LE(done, 1.0);
      last = done;
      return done <= limit;
    });
    EXPECT_TRUE(absl::IsCancelled(result.status())) << limit;
    EXPECT_GT(last, limit);
    EXPECT_TRUE(absl::IsFailedPrecondition(mapper->Finish().status()));
  }
}

TEST(FloorPlanMapper, ADriveWithoutScansOrOdometryIsRefusedWithTheReason) {
  SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), InTheHall(), 16);
  SimulatedLaserDrive nothing = drive, no_odometry = drive, no_scans = drive;
  nothing.frames.clear();
  std::erase_if(no_odometry.frames,
                [](const auto& frame) { return std::holds_alternative<frames::Odometry>(frame); });
  std::erase_if(no_scans.frames,
                [](const auto& frame) { return std::holds_alternative<frames::LaserScan>(frame); });
  EXPECT_THAT(std::string(Map(nothing).status().message()), HasSubstr("no LRF scans"));
  EXPECT_THAT(std::string(Map(no_scans).status().message()), HasSubstr("no LRF scans"));
  EXPECT_THAT(std::string(Map(no_odometry).status().message()), HasSubstr("no odometry"));
}

TEST(FloorPlanMapper, HostileFramesAreRefusedAndTheDriveGoesOn) {
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), InTheHall(), 17);
  auto mapper = FloorPlanMapper::Create({}, drive.calibration, drive.start);
  ASSERT_TRUE(mapper.ok());
  for (std::size_t i = 0; i < drive.frames.size(); ++i) {
    ASSERT_TRUE(mapper->Add(drive.frames[i]).ok());
    if (i != 50) continue;
    frames::LaserScan scan{.stamp_ns = -1, .angle_increment_rad = 0.01, .range_m = {1, 2}};
    EXPECT_FALSE(mapper->Add(scan).ok());
    scan.stamp_ns = std::numeric_limits<frames::TimeNs>::max();
    EXPECT_FALSE(mapper->Add(scan).ok());
    scan.stamp_ns = frames::StampOf(drive.frames[i]);
    scan.angle_increment_rad = std::numeric_limits<double>::infinity();
    EXPECT_FALSE(mapper->Add(scan).ok());
    scan.angle_increment_rad = 0.01;
    scan.range_m.assign(70000, 1.0f);
    EXPECT_FALSE(mapper->Add(scan).ok());
    scan.range_m.clear();
    EXPECT_TRUE(mapper->Add(scan).ok());  // dropped
    EXPECT_FALSE(mapper->Add(frames::Odometry{-5, {}}).ok());
    EXPECT_TRUE(mapper->Add(frames::Odometry{1, {}}).ok());  // older: left out
    EXPECT_TRUE(mapper->Add(frames::AudioBlock{}).ok());
  }
  const auto result = mapper->Finish();
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->report.scans_dropped, 5);
  EXPECT_LT(DeviationOf(result->report.path, drive.truth).max_m, 0.03);
}

TEST(FloorPlanMapper, UnusableConfigurationsAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto refused = [](auto change) {
    FloorPlanMapperConfig config;
    change(config);
    return absl::IsInvalidArgument(FloorPlanMapper::Create(config, {}, {}).status());
  };
  EXPECT_FALSE(refused([](auto&) {}));
  EXPECT_TRUE(refused([&](auto& c) { c.cell_size_m = nan; }));
  EXPECT_TRUE(refused([](auto& c) { c.min_range_m = 50.0; }));
  EXPECT_TRUE(refused([](auto& c) { c.laser_lag_s = 2.0; }));
  EXPECT_TRUE(refused([](auto& c) { c.key_scan_distance_m = 0.0; }));
  EXPECT_TRUE(refused([](auto& c) { c.key_scans_per_place = 0; }));
  EXPECT_TRUE(refused([](auto& c) { c.wall_piece_m = 0.0; }));
  EXPECT_TRUE(refused([](auto& c) { c.loop_search_m = -1.0; }));
  EXPECT_TRUE(refused([](auto& c) { c.relaxation_passes = -1; }));
  EXPECT_TRUE(refused([&](auto& c) { c.max_speed_mps = nan; }));
  EXPECT_TRUE(refused([](auto& c) { c.occupancy.hit_log_odds = -1.0; }));
  EXPECT_FALSE(FloorPlanMapper::Create({}, {}, {nan, 0, 0}).ok());
}

// A robot that goes round and round keeps no more than the places need.
TEST(FloorPlanMapper, WhatIsKeptDoesNotGrowWithTheDrive) {
  LaserDriveModel model;
  model.corners = {{2, 2}, {7, 2}, {7, 5}, {2.5, 5}, {2, 2}};
  model.scan_rate_hz = 5.0;
  FloorPlanMapperConfig config;
  config.key_scans_per_place = 4;
  const auto go_on = [&model](int laps) {
    for (int lap = 0; lap < laps; ++lap) {
      model.corners.insert(model.corners.end(), {{7, 2}, {7, 5}, {2.5, 5}, {2, 2}});
    }
  };
  go_on(3);
  const auto some = Map(SimulateLaserDrive(FurnishedHall(), model, 18), config);
  go_on(6);
  const SimulatedLaserDrive drive = SimulateLaserDrive(FurnishedHall(), model, 18);
  const auto often = Map(drive, config);
  ASSERT_TRUE(some.ok() && often.ok());
  EXPECT_GT(often->report.scans, 2 * some->report.scans);
  EXPECT_LT(often->report.key_scans, 1.2 * some->report.key_scans);
  EXPECT_LT(DeviationOf(often->report.path, drive.truth).max_m, 0.05);
}

}  // namespace
}  // namespace soundmap::mapping
