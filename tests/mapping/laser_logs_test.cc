#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "mapping/floor_plan_mapper.h"
#include "tests/mapping/laser_drive.h"

namespace soundmap::mapping {
namespace {

std::string SharedData() {
  const char* folder = std::getenv("SOUNDMAP_DATA");
  return folder ? folder : std::string(SOUNDMAP_SOURCE_DIR) + "/../shared/data";
}

#define SKIP_WITHOUT(path) \
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "the shared log " << (path) << " is not here"

absl::StatusOr<FloorPlanReport> Map(const std::string& log,
                                    std::vector<StampedPose> surveyed = {}) {
  const auto drive = ReadCarmenDrive(log);
  if (!drive.ok()) return drive.status();
  auto mapper = FloorPlanMapper::Create({}, drive->calibration, {}, std::move(surveyed));
  if (!mapper.ok()) return mapper.status();
  for (const frames::Frame& frame : drive->frames) {
    if (const absl::Status status = mapper->Add(frame); !status.ok()) return status;
  }
  auto result = mapper->Finish();
  if (!result.ok()) return result.status();
  return result->report;
}

// Published (Hess et al. 2016): RBPF 0.060 m, graph mapping 0.044 m, Cartographer 0.038 m.
TEST(LaserLogs, AcesFromLrfAndOdometryAlone) {
  const std::string log = SharedData() + "/aces/aces.clf.bz2";
  SKIP_WITHOUT(log);
  const auto relations = ReadRelations(SharedData() + "/aces/aces.relations");
  const auto report = Map(log);
  ASSERT_TRUE(report.ok()) << report.status();
  const RelationsError error = ErrorOfRelations(report->path, relations);
  EXPECT_EQ(error.relations, 1279);
  EXPECT_LE(error.mean_m, 0.040);
  EXPECT_LE(error.mean_deg, 0.5);
  EXPECT_NEAR(report->laser_lag_s, 0.10, 0.03);  // as the data's description says
  EXPECT_GT(report->loops_closed, 50);
}

TEST(LaserLogs, AcesFromCorrectedPoses) {
  const std::string log = SharedData() + "/aces/aces.clf.bz2";
  SKIP_WITHOUT(log);
  const auto report = Map(log, ReadPoses(SharedData() + "/aces/corrected_poses.csv"));
  ASSERT_TRUE(report.ok()) << report.status();
  const RelationsError error =
      ErrorOfRelations(report->path, ReadRelations(SharedData() + "/aces/aces.relations"));
  EXPECT_LE(error.mean_m, 0.045);
}

// Its odometry stops for up to a second at a time and then catches up; the corrected poses are
// those of another program.
TEST(LaserLogs, CsailFromLrfAndOdometryAlone) {
  const std::string log = SharedData() + "/mit_csail/mit-csail.clf.bz2";
  SKIP_WITHOUT(log);
  const auto report = Map(log);
  ASSERT_TRUE(report.ok()) << report.status();
  const PathError error =
      ErrorOfPath(report->path, ReadPoses(SharedData() + "/mit_csail/corrected_poses.csv"));
  EXPECT_GT(error.poses, 400);
  EXPECT_LE(error.mean_m, 0.12);
  EXPECT_LE(error.max_m, 0.5);
}

// Two drives that share a part of the building; the odometry of the second begins anywhere.
struct Halves {
  LaserDrive first, second;
  frames::TimeNs second_begin_ns = 0;
};

Halves InHalves(const LaserDrive& drive, double first_until, double second_from) {
  const auto at = [&drive](double share) {
    return drive.frames.begin() +
           static_cast<std::ptrdiff_t>(share * static_cast<double>(drive.frames.size()));
  };
  Halves halves{{drive.calibration, {drive.frames.begin(), at(first_until)}},
                {drive.calibration, {at(second_from), drive.frames.end()}}};
  halves.second_begin_ns = frames::StampOf(*at(second_from));
  for (frames::Frame& frame : halves.second.frames) {
    if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      odometry->odom_from_base = geometry::Pose2{-31.0, 12.5, 2.1} * odometry->odom_from_base;
    }
  }
  return halves;
}

absl::Status AddAll(const LaserDrive& drive, FloorPlanMapper& mapper) {
  for (const frames::Frame& frame : drive.frames) {
    if (const absl::Status status = mapper.Add(frame); !status.ok()) return status;
  }
  return absl::OkStatus();
}

// The first drive's poses up to where the second begins, then those of the second.
std::vector<StampedPose> OnePath(const FloorPlanReport& report, frames::TimeNs second_begin_ns) {
  std::vector<StampedPose> path;
  for (std::size_t i = 0; i < report.path.size(); ++i) {
    if (i >= report.drive_begin[1] || report.path[i].stamp_ns < second_begin_ns) {
      path.push_back(report.path[i]);
    }
  }
  return path;
}

TEST(LaserLogs, TwoDrivesOfAcesMerge) {
  const std::string log = SharedData() + "/aces/aces.clf.bz2";
  SKIP_WITHOUT(log);
  const auto drive = ReadCarmenDrive(log);
  ASSERT_TRUE(drive.ok());
  const Halves halves = InHalves(*drive, 0.55, 0.45);
  auto mapper = FloorPlanMapper::Create({}, halves.first.calibration, {});
  ASSERT_TRUE(mapper.ok());
  ASSERT_TRUE(AddAll(halves.first, *mapper).ok());
  ASSERT_TRUE(mapper->BeginDrive(halves.second.calibration, std::nullopt).ok());
  ASSERT_TRUE(AddAll(halves.second, *mapper).ok());
  const auto result = mapper->Finish();
  ASSERT_TRUE(result.ok()) << result.status();
  const auto relations = ReadRelations(SharedData() + "/aces/aces.relations");
  const RelationsError error =
      ErrorOfRelations(OnePath(result->report, halves.second_begin_ns), relations);
  EXPECT_EQ(error.relations, 1279);
  EXPECT_LE(error.mean_m, 0.040);
  EXPECT_LE(error.mean_deg, 0.5);
  RecordProperty("mean_mm", static_cast<int>(1e3 * error.mean_m));
}

// Its odometry never reports reverse.
TEST(LaserLogs, Building079FromLrfAndOdometryAlone) {
  const std::string log = SharedData() + "/building_079/fr079_first_150s.clf.bz2";
  SKIP_WITHOUT(log);
  const auto report = Map(log);
  ASSERT_TRUE(report.ok()) << report.status();
  const PathError error =
      ErrorOfPath(report->path, ReadPoses(SharedData() + "/building_079/corrected_poses.csv"));
  EXPECT_GT(error.poses, 650);
  EXPECT_LE(error.mean_m, 0.10);
  EXPECT_LE(error.max_m, 0.25);
}

}  // namespace
}  // namespace soundmap::mapping
