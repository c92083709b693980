#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "localization/localizer.h"
#include "recording/drive.h"
#include "recording/reader.h"

// The filter on a recorded drive, on a floor plan drawn from the truth's room and obstacles,
// against the recorded true poses.
namespace soundmap::localization {
namespace {

using building::Cell;
using building::FloorPlan;
using geometry::Pose2;

constexpr double kCellSize_m = 0.05;
constexpr double kMargin_m = 0.4;
constexpr double kLaserHeight_m = 0.3;

std::filesystem::path DataFolder() {
  if (const char* folder = std::getenv("SOUNDMAP_DATA")) return folder;
  return std::filesystem::path(SOUNDMAP_SOURCE_DIR) / ".." / "shared" / "data";
}

FloorPlan DrawPlan(const nlohmann::json& truth) {
  const double room_x_m = truth["room"][0];
  const double room_y_m = truth["room"][1];
  const int width = static_cast<int>(std::lround((room_x_m + 2.0 * kMargin_m) / kCellSize_m));
  const int height = static_cast<int>(std::lround((room_y_m + 2.0 * kMargin_m) / kCellSize_m));
  FloorPlan plan(width, height, kCellSize_m, {-kMargin_m, -kMargin_m});
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const double x_m = (column + 0.5) * kCellSize_m - kMargin_m;
      const double y_m = (row + 0.5) * kCellSize_m - kMargin_m;
      bool free = x_m > 0.0 && y_m > 0.0 && x_m < room_x_m && y_m < room_y_m;
      for (const auto& box : truth["obstacles"]) {
        const bool at_height = box[0][2] < kLaserHeight_m && box[1][2] > kLaserHeight_m;
        free = free && !(at_height && x_m > box[0][0] && y_m > box[0][1] && x_m < box[1][0] &&
                         y_m < box[1][1]);
      }
      plan.at(column, row) = free ? Cell::kFree : Cell::kOccupied;
    }
  }
  return plan;
}

struct Drive {
  std::vector<frames::Frame> frames;
  std::vector<recording::StampedPose> truth;
  frames::Calibration calibration;
};

Drive ReadDrive(const std::string& path) {
  Drive drive;
  const auto survey = recording::SurveyDrive(path);
  EXPECT_TRUE(survey.ok()) << survey.status();
  drive.calibration.base_from_laser = survey->transforms.Find("base_link", "laser").value();
  drive.truth = recording::ReadGroundTruth(path).value();
  auto reader = recording::Reader::Open(path).value();
  while (true) {
    const auto message = reader->Next().value();
    if (!message) break;
    if (message->topic == recording::kOdometryTopic) {
      foxglove::Odometry odometry;
      EXPECT_TRUE(odometry.ParseFromString(message->data));
      const auto& q = odometry.pose().orientation();
      drive.frames.emplace_back(
          frames::Odometry{recording::NsFromTimestamp(odometry.timestamp()).value(),
                           {odometry.pose().position().x(), odometry.pose().position().y(),
                            2.0 * std::atan2(q.z(), q.w())}});
    } else if (message->topic == recording::kLaserTopic) {
      foxglove::LaserScan scan;
      EXPECT_TRUE(scan.ParseFromString(message->data));
      frames::LaserScan out{recording::NsFromTimestamp(scan.timestamp()).value(),
                            scan.start_angle(),
                            (scan.end_angle() - scan.start_angle()) / (scan.ranges_size() - 1),
                            {}};
      for (const double range_m : scan.ranges()) {
        out.range_m.push_back(range_m > 0.0 ? static_cast<float>(range_m) : NAN);
      }
      drive.frames.emplace_back(std::move(out));
    }
  }
  return drive;
}

struct Errors {
  std::vector<double> position_m;
  std::vector<double> yaw_rad;
  int not_tracking = 0;
};

Errors Localize(const Drive& drive, const std::shared_ptr<const PreparedPlan>& plan,
                std::uint64_t seed) {
  const Pose2 start = geometry::ProjectToFloor(drive.truth.front().map_from_base);
  Localizer localizer =
      Localizer::Create(plan, drive.calibration, InitialPose{start}, seed).value();
  Errors errors;
  std::size_t next = 0;
  for (const frames::Frame& frame : drive.frames) {
    if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      localizer.Add(*odometry);
    } else {
      localizer.Add(std::get<frames::LaserScan>(frame));
    }
    for (; next < drive.truth.size() &&
           drive.truth[next].time_ns + 1'000'000'000 < frames::StampOf(frame);
         ++next) {
      const auto estimate = localizer.At(drive.truth[next].time_ns);
      if (!estimate) {
        ADD_FAILURE() << "no pose at " << drive.truth[next].time_ns;
        continue;
      }
      const Pose2 truth = geometry::ProjectToFloor(drive.truth[next].map_from_base);
      errors.position_m.push_back(std::hypot(estimate->map_from_base.x_m - truth.x_m,
                                             estimate->map_from_base.y_m - truth.y_m));
      errors.yaw_rad.push_back(
          std::abs(geometry::NormalizeAngle(estimate->map_from_base.yaw_rad - truth.yaw_rad)));
      errors.not_tracking += estimate->state != State::kTracking;
    }
  }
  return errors;
}

double Mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

double Quantile95(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() * 95 / 100];
}

class GrillRoom : public testing::TestWithParam<bool> {};

TEST_P(GrillRoom, PoseErrorOverFiveSeeds) {
  const std::filesystem::path folder = DataFolder() / "grill_room";
  if (!std::filesystem::exists(folder / "drive.mcap")) {
    GTEST_SKIP() << "no grill_room/drive.mcap in " << DataFolder() << " (set SOUNDMAP_DATA)";
  }
  const bool paper = GetParam();
  const Drive drive = ReadDrive(folder / "drive.mcap");
  std::ifstream truth(folder / "drive.truth.json");
  const auto plan = PreparedPlan::Create(paper ? PaperConfig() : DefaultConfig(),
                                         DrawPlan(nlohmann::json::parse(truth)));
  ASSERT_TRUE(plan.ok()) << plan.status();
  for (std::uint64_t seed = 0; seed < 5; ++seed) {
    const Errors errors = Localize(drive, *plan, seed);
    ASSERT_GT(errors.position_m.size(), 800u);
    const double mean_m = Mean(errors.position_m);
    const double yaw_mean_deg = geometry::DegFromRad(Mean(errors.yaw_rad));
    EXPECT_LE(mean_m, paper ? 0.05 : 0.01) << seed;
    EXPECT_LE(Quantile95(errors.position_m), paper ? 0.10 : 0.02) << seed;
    EXPECT_LE(yaw_mean_deg, paper ? 0.3 : 0.1) << seed;
    EXPECT_EQ(errors.not_tracking, 0) << seed;
    RecordProperty("mean_mm_" + std::to_string(seed), std::to_string(1000.0 * mean_m));
  }
}

INSTANTIATE_TEST_SUITE_P(Profiles, GrillRoom, testing::Bool(), [](const auto& info) {
  return info.param ? std::string("Paper") : std::string("Default");
});

}  // namespace
}  // namespace soundmap::localization
