#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "sources/convert/convert.h"
#include "tests/convert/carmen_logs.h"

namespace soundmap::convert {
namespace {

std::string SharedData() {
  const char* folder = std::getenv("SOUNDMAP_DATA");
  return folder ? folder : std::string(SOUNDMAP_SOURCE_DIR) + "/../shared/data";
}

struct Expected {
  std::string log;
  std::string poses;
  int scans;
  int beams;
  double no_return_m;  // as the data's own description says
};

class SharedLogs : public ::testing::TestWithParam<Expected> {};

TEST_P(SharedLogs, HaveTheScansThatTheirDescriptionCounts) {
  const Expected& expected = GetParam();
  const std::string log = SharedData() + "/" + expected.log;
  if (!std::filesystem::exists(log)) GTEST_SKIP() << "the shared log " << log << " is not here";
  const std::string out = FreshPath("drive.mcap");
  const auto result = Convert(
      log, out, {.truth_path = SharedData() + "/" + expected.poses, .truth_is_of_laser = true});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_TRUE(result->damage.ok());
  EXPECT_EQ(result->scans, expected.scans);
  EXPECT_EQ(result->beams, expected.beams);
  EXPECT_GT(result->no_return_beams, 1000);
  EXPECT_LE(result->no_return_from_m, expected.no_return_m);
  EXPECT_GT(result->no_return_from_m, expected.no_return_m - 2.0);

  const Recorded recorded = ReadRecording(out);
  ASSERT_EQ(static_cast<int>(recorded.scans.size()), expected.scans);
  std::int64_t no_return = 0;
  for (const foxglove::LaserScan& scan : recorded.scans) {
    ASSERT_EQ(scan.ranges_size(), expected.beams);
    for (const double range_m : scan.ranges()) {
      if (!std::isfinite(range_m)) ++no_return;
    }
  }
  EXPECT_EQ(no_return, result->no_return_beams);
  EXPECT_FALSE(recorded.truth.empty());
}

INSTANTIATE_TEST_SUITE_P(
    Logs, SharedLogs,
    ::testing::Values(Expected{"aces/aces.clf.bz2", "aces/corrected_poses.csv", 7374, 180, 50.0},
                      Expected{"mit_csail/mit-csail.clf.bz2", "mit_csail/corrected_poses.csv", 1988,
                               361, 81.91},
                      Expected{"building_079/fr079_first_150s.clf.bz2",
                               "building_079/corrected_poses.csv", 699, 360, 81.9}));

}  // namespace
}  // namespace soundmap::convert
