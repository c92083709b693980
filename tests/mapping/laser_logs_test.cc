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
