#include "sources/convert/convert.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>
#include <random>

#include "tests/convert/carmen_logs.h"

namespace soundmap::convert {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr double kPi = std::numbers::pi;

Recorded Converted(const std::string& log, const ConvertOptions& options = {},
                   ConvertResult* result = nullptr) {
  const std::string in = FreshPath("drive.log"), out = FreshPath("drive.mcap");
  WriteBytes(in, log);
  const auto converted = Convert(in, out, options);
  EXPECT_TRUE(converted.ok()) << converted.status();
  if (!converted.ok()) return {};
  EXPECT_TRUE(converted->damage.ok()) << converted->damage;
  if (result) *result = *converted;
  return ReadRecording(out);
}

absl::Status Refusal(const std::string& log, const ConvertOptions& options = {}) {
  const std::string in = FreshPath("drive.log"), out = FreshPath("drive.mcap");
  WriteBytes(in, log);
  const absl::Status status = Convert(in, out, options).status();
  EXPECT_FALSE(std::filesystem::exists(out));
  return status;
}

double Seconds(const google::protobuf::Timestamp& stamp) {
  return static_cast<double>(stamp.seconds()) + 1e-9 * stamp.nanos();
}

TEST(Convert, GivesScansAndOdometryInOrderOfTheirTimes) {
  // The logger had the scan of 10.1 s after the odometry of 10.2 s.
  const Recorded drive = Converted(
      "# comment\n" + OdometryLine(1, 2, 0.5, 10.0) + OdometryLine(1.5, 2.5, -0.25, 10.2) +
      LaserLine({"1.5", "2.25", "3"}, 10.1) + "SYNC start 10.3 robot 0\n");
  ASSERT_EQ(drive.scans.size(), 1u);
  EXPECT_DOUBLE_EQ(Seconds(drive.scans[0].timestamp()), 10.1);
  EXPECT_THAT(drive.scans[0].ranges(), ElementsAre(1.5, 2.25, 3.0));
  EXPECT_EQ(drive.scans[0].frame_id(), "laser");
  ASSERT_EQ(drive.odometry.size(), 2u);
  EXPECT_DOUBLE_EQ(Seconds(drive.odometry[1].timestamp()), 10.2);
  EXPECT_DOUBLE_EQ(drive.odometry[1].pose().position().x(), 1.5);
  EXPECT_DOUBLE_EQ(drive.odometry[1].pose().position().y(), 2.5);
  EXPECT_NEAR(2 * std::atan2(drive.odometry[1].pose().orientation().z(),
                             drive.odometry[1].pose().orientation().w()),
              -0.25, 1e-12);
  EXPECT_TRUE(std::is_sorted(drive.log_times_ns.begin(), drive.log_times_ns.end()));
}

TEST(Convert, FirstBeamLooksRightAndBeamsAreADegreeOrHalfApart) {
  const std::pair<int, double> cases[] = {{180, 1.0}, {181, 1.0}, {360, 0.5}, {361, 0.5}};
  for (const auto& [beams, step_deg] : cases) {
    const Recorded drive = Converted(LaserLine(Repeated("2", beams), 1.0));
    ASSERT_EQ(drive.scans.size(), 1u);
    EXPECT_NEAR(drive.scans[0].start_angle(), -kPi / 2, 1e-12);
    EXPECT_NEAR((drive.scans[0].end_angle() - drive.scans[0].start_angle()) / (beams - 1),
                step_deg * kPi / 180, 1e-12)
        << beams;
  }
}

TEST(Convert, KnownCodesAreNoReturn) {
  const Recorded drive = Converted(LaserLine(
      {"81.83", "81.91", "81.90", "81", "80", "inf", "nan", "0", "-1", "1e9", "79.9", "4"}, 1.0));
  ASSERT_EQ(drive.scans.size(), 1u);
  for (int i = 0; i < 10; ++i) EXPECT_FALSE(std::isfinite(drive.scans[0].ranges(i))) << i;
  EXPECT_NEAR(drive.scans[0].ranges(10), 79.9, 1e-5);
  EXPECT_EQ(drive.scans[0].ranges(11), 4.0);
}

// A wall at the end of a hall is spread by the laser's noise; a code stands alone.
TEST(Convert, ALargestRangeThatStandsAloneIsACodeAndAFarWallIsNot) {
  std::mt19937 random(1);
  std::normal_distribution<double> wall_m(49.0, 0.02);
  std::string with_code, with_wall;
  for (int scan = 0; scan < 50; ++scan) {
    std::vector<std::string> coded, far;
    for (int beam = 0; beam < 20; ++beam) {
      coded.push_back(beam < 5 ? "50.00" : "3.21");
      far.push_back(beam < 5 ? std::to_string(std::round(wall_m(random) * 100) / 100) : "3.21");
    }
    with_code += LaserLine(coded, 1.0 + scan);
    with_wall += LaserLine(far, 1.0 + scan);
  }
  ConvertResult result;
  const Recorded coded = Converted(with_code, {}, &result);
  EXPECT_EQ(result.no_return_beams, 250);
  EXPECT_EQ(result.no_return_from_m, 50.0);
  for (int beam = 0; beam < 20; ++beam) {
    EXPECT_EQ(std::isfinite(coded.scans[7].ranges(beam)), beam >= 5) << beam;
  }
  Converted(with_wall, {}, &result);
  EXPECT_EQ(result.no_return_beams, 0);
}

TEST(Convert, AGivenMaximumRangeHolds) {
  ConvertResult result;
  const Recorded drive =
      Converted(LaserLine({"5.9", "6.0", "7.5"}, 1.0), {.max_range_m = 6.0}, &result);
  EXPECT_EQ(drive.scans[0].ranges(0), static_cast<double>(5.9f));
  EXPECT_FALSE(std::isfinite(drive.scans[0].ranges(1)));
  EXPECT_FALSE(std::isfinite(drive.scans[0].ranges(2)));
  EXPECT_EQ(result.no_return_beams, 2);
}

TEST(Convert, TheLasersPlaceComesFromItsPose) {
  // Base at (3, 4) looking along y; the laser 0.2 m ahead and 0.1 m to the left: at (2.9, 4.2).
  const double yaw = kPi / 2;
  std::string log;
  for (int i = 0; i < 3; ++i) {
    log += LaserLine({"1", "2"}, 1.0 + i, "2.9 4.2 " + std::to_string(yaw),
                     "3.0 4.0 " + std::to_string(yaw));
  }
  const Recorded drive = Converted(log, {.laser_height_m = 0.42});
  ASSERT_TRUE(drive.robot.base_from_laser);
  const Eigen::Vector3d place = drive.robot.base_from_laser->translation();
  EXPECT_NEAR(place.x(), 0.2, 1e-6);
  EXPECT_NEAR(place.y(), 0.1, 1e-6);
  EXPECT_DOUBLE_EQ(place.z(), 0.42);
}

TEST(Convert, CorrectedLaserPosesDoNotMoveTheLaser) {
  const std::string log = "PARAM robot_frontlaser_offset 0.15 robot 0\n" +
                          LaserLine({"1", "2"}, 1.0, "1 2 0", "1 2 0") +
                          LaserLine({"1", "2"}, 2.0, "2 5 1", "1 2 0");
  const Recorded drive = Converted(log);
  EXPECT_NEAR(drive.robot.base_from_laser->translation().x(), 0.15, 1e-12);
}

TEST(Convert, OdometryOfTheScansServesWhereThereIsNoOther) {
  const Recorded drive = Converted(LaserLine({"1", "2"}, 1.0, "1 2 0.5", "1 2 0.5") +
                                   LaserLine({"1", "2"}, 2.0, "3 2 0.5", "3 2 0.5"));
  ASSERT_EQ(drive.odometry.size(), 2u);
  EXPECT_EQ(drive.odometry[1].pose().position().x(), 3.0);
  EXPECT_EQ(Seconds(drive.odometry[1].timestamp()), 2.0);
}

TEST(Convert, ReadsRobotLaserAndRawLaser) {
  const std::string head = "0 -2.0 4.0 2.0 30.0 0.01 0 3 1.5 30.0 2.5 0";
  const Recorded robot =
      Converted("ROBOTLASER1 " + head + " 1 2 0.5 1 2 0.5 0 0 0 0 0 5.5 robot 0.1\n");
  ASSERT_EQ(robot.scans.size(), 1u);
  EXPECT_DOUBLE_EQ(robot.scans[0].start_angle(), -2.0);
  EXPECT_DOUBLE_EQ(robot.scans[0].end_angle(), 2.0);
  EXPECT_FALSE(std::isfinite(robot.scans[0].ranges(1)));  // the declared maximum
  EXPECT_EQ(robot.odometry.size(), 1u);
  const Recorded raw =
      Converted("RAWLASER1 " + head + " 5.5 robot 0.1\n" + OdometryLine(1, 2, 0, 5.4));
  ASSERT_EQ(raw.scans.size(), 1u);
  EXPECT_DOUBLE_EQ(Seconds(raw.scans[0].timestamp()), 5.5);
  EXPECT_EQ(raw.odometry.size(), 1u);
}

TEST(Convert, RemissionsAreReadOver) {
  const Recorded drive = Converted(
      "ROBOTLASER1 0 -1 2 1 30 0.01 1 3 1.5 2.5 3.5 3 900 901 902 1 2 0.5 1 2 0.5 0 0 0 0 0 5.5 "
      "robot 0.1\n");
  ASSERT_EQ(drive.scans.size(), 1u);
  EXPECT_THAT(drive.scans[0].ranges(), ElementsAre(1.5, 2.5, 3.5));
}

// The odometry's host is 1000 s ahead of the laser's; its messages took 0.02 s or more to the
// logger, the laser's 0.05 s or more.
TEST(Convert, ClocksOfTwoHostsAreBroughtTogether) {
  std::string log;
  for (int i = 0; i < 20; ++i) {
    const double logger_s = 7.0 + 0.1 * i;
    log += OdometryLine(i, 0, 0, logger_s + 1000.0 - 0.02 - 0.03 * (i % 3), "base", logger_s);
    log += LaserLine({"1", "2"}, logger_s + 300.0 - 0.05 - 0.01 * (i % 4), "0 0 0", "0 0 0",
                     "scanner", logger_s);
  }
  const Recorded drive = Converted(log);
  ASSERT_EQ(drive.scans.size(), 20u);
  ASSERT_EQ(drive.odometry.size(), 20u);
  // What both hosts sent by their fastest message at the logger's 7.0 s.
  EXPECT_NEAR(Seconds(drive.scans[0].timestamp()), 306.95, 1e-6);
  EXPECT_NEAR(Seconds(drive.odometry[0].timestamp()), 306.95, 1e-6);
}

TEST(Convert, TimesThatDoNotIncreaseAreLeftOut) {
  ConvertResult result;
  const Recorded drive = Converted(OdometryLine(1, 0, 0, 1.0) + OdometryLine(2, 0, 0, 1.0) +
                                       OdometryLine(3, 0, 0, 0.5) + OdometryLine(4, 0, 0, 2.0) +
                                       LaserLine({"1", "2"}, 3.0) + LaserLine({"3", "4"}, 2.9) +
                                       LaserLine({"5", "6"}, 3.1),
                                   {}, &result);
  ASSERT_EQ(drive.odometry.size(), 2u);
  EXPECT_EQ(drive.odometry[1].pose().position().x(), 4.0);
  ASSERT_EQ(drive.scans.size(), 2u);
  EXPECT_EQ(drive.scans[1].ranges(0), 5.0);
  EXPECT_THAT(result.warnings, ElementsAre(HasSubstr("1 scans"), HasSubstr("2 odometry lines")));
}

TEST(Convert, HostileLinesAreCountedAndNamed) {
  const std::string good = LaserLine({"1", "2"}, 1.0);
  const std::string hostile =
      "FLASER\n"                                        // 2
      "FLASER 3 1 2 0 0 0 0 0 0 1.0 robot 0\n"          // 3: too few ranges
      "FLASER -1 0 0 0 0 0 0 1.0 robot 0\n"             // 4
      "FLASER 2147483648 1 2\n"                         // 5
      "FLASER 0 0 0 0 0 0 0 1.0 robot 0\n"              // 6
      "FLASER 2 1 x 0 0 0 0 0 0 1.0 robot 0\n"          // 7
      "FLASER 2 1 2 nan 0 0 0 0 0 1.0 robot 0\n"        // 8
      "FLASER 2 1 2 0 0 0 0 0 0 inf robot 0\n"          // 9
      "FLASER 2 1 2 0 0 0 0 0 0 -5 robot 0\n"           // 10
      "FLASER 2 1 2 0 0 0 0 0 0 1e300 robot 0\n"        // 11
      "FLASER 2 1 2 0 0 0 0 0 0 9.0 robot 0 more\n"     // 12
      "ODOM 1 2\n"                                      // 13
      "ODOM 1e300 2 0 0 0 0 9 robot 0\n"                // 14
      "ROBOTLASER1 0 0 1 0 30 0 0 2 1 2 0 9 robot 0\n"  // 15
      "\n"
      "\x01\xff\xfe binary \x02\n"
      "UNKNOWN 1 2 3\n";
  ConvertResult result;
  const Recorded drive = Converted(good + hostile + LaserLine({"3", "4"}, 2.0), {}, &result);
  EXPECT_EQ(drive.scans.size(), 2u);
  ASSERT_EQ(result.warnings.size(), 1u);
  EXPECT_THAT(result.warnings[0],
              HasSubstr("14 malformed lines are left out: 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, ..."));
}

TEST(Convert, ALogWithoutALaserLineIsRefusedAndNothingIsWritten) {
  EXPECT_THAT(std::string(Refusal(OdometryLine(1, 2, 0, 1.0)).message()),
              HasSubstr("no usable line of a front laser"));
  EXPECT_FALSE(Refusal("").ok());
  EXPECT_FALSE(Refusal("RLASER 1 2 0 0 0 0 0 0 1 robot 0\n").ok());
}

TEST(Convert, UnusableOptionsAndFilesAreRefused) {
  const std::string log = LaserLine({"1", "2"}, 1.0);
  EXPECT_FALSE(Refusal(log, {.max_range_m = -1.0}).ok());
  EXPECT_FALSE(Refusal(log, {.laser_height_m = std::numeric_limits<double>::quiet_NaN()}).ok());
  EXPECT_FALSE(Refusal(log, {.truth_path = "/nonexistent.csv"}).ok());
  EXPECT_FALSE(Convert("/nonexistent.log", FreshPath("x.mcap")).ok());
  EXPECT_FALSE(Convert("/", FreshPath("x.mcap")).ok());
}

TEST(Convert, DoesNotOverwrite) {
  const std::string in = FreshPath("drive.log"), out = FreshPath("drive.mcap");
  WriteBytes(in, LaserLine({"1", "2"}, 1.0));
  WriteBytes(out, "precious");
  EXPECT_FALSE(Convert(in, out).ok());
  EXPECT_EQ(ReadBytes(out), "precious");
}

TEST(Convert, TrueLaserPosesBecomeThoseOfTheBase) {
  // The laser is 0.2 m ahead of the base.
  std::string log;
  for (int i = 0; i < 2; ++i) log += LaserLine({"1", "2"}, 1.0 + i, "0.2 0 0", "0 0 0");
  const std::string truth = FreshPath("poses.csv");
  WriteBytes(truth, "# comment\n1.5, 5, 7, 1.5707963267948966\n1.75,5,8,0\n");
  const Recorded of_laser = Converted(log, {.truth_path = truth, .truth_is_of_laser = true});
  ASSERT_EQ(of_laser.truth.size(), 2u);
  EXPECT_NEAR(of_laser.truth[0].pose().position().x(), 5.0, 1e-9);
  EXPECT_NEAR(of_laser.truth[0].pose().position().y(), 6.8, 1e-9);
  const Recorded of_base = Converted(log, {.truth_path = truth});
  EXPECT_DOUBLE_EQ(of_base.truth[0].pose().position().y(), 7.0);
  EXPECT_DOUBLE_EQ(Seconds(of_base.truth[0].timestamp()), 1.5);

  WriteBytes(truth, "1.5,5,7\n");
  EXPECT_FALSE(Refusal(log, {.truth_path = truth}).ok());
  WriteBytes(truth, "1.5,5,7,0\n1.5,5,7,0\n");
  EXPECT_THAT(std::string(Refusal(log, {.truth_path = truth}).message()), HasSubstr("line 2"));
}

}  // namespace
}  // namespace soundmap::convert
