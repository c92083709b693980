#include "cli/drive_truth.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <numbers>

#include "absl/strings/match.h"
#include "cli/truth_file.h"
#include "cli/visibility.h"
#include "recording/foxglove_messages.h"

namespace soundmap::cli {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kS = 1'000'000'000;

struct DriveOptions {
  std::string frame = "map";
  bool poses = true;
  double x_of_last_pose = 3.0;
};

std::string WriteDrive(const std::string& name, const DriveOptions& options = {}) {
  const std::string path = ::testing::TempDir() + name;
  fs::remove(path);
  auto writer = recording::Writer::Create(path, {}).value();
  foxglove::FrameTransforms transforms;
  Eigen::Isometry3d base_from_array = Eigen::Isometry3d::Identity();
  base_from_array.translation() = Eigen::Vector3d(0.1, -0.2, 1.3);
  *transforms.add_transforms() =
      recording::MakeFrameTransform(50 * kS, "base_link", "mic_array", base_from_array);
  EXPECT_TRUE(
      recording::WriteMessage(*writer, recording::kTransformsTopic, 50 * kS, 0, transforms).ok());
  if (options.poses) {
    for (const int i : {1, 0, 2}) {  // written out of order
      Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
      pose.translation() = Eigen::Vector3d(i == 2 ? options.x_of_last_pose : i, 2.0, 0.0);
      pose.linear() = Eigen::AngleAxisd(-2.0, Eigen::Vector3d::UnitZ()).toRotationMatrix();
      EXPECT_TRUE(
          recording::WriteMessage(*writer, recording::kGroundTruthTopic, (51 + i) * kS, i,
                                  recording::MakePoseInFrame((51 + i) * kS, options.frame, pose))
              .ok());
    }
  }
  EXPECT_TRUE(writer->Close().ok());
  return path;
}

TEST(ReadDriveTruth, ReadsPosesAndTheArray) {
  const auto truth = ReadDriveTruth(WriteDrive("drive.mcap"));
  ASSERT_TRUE(truth.ok()) << truth.status();
  EXPECT_EQ(truth->start_ns, 50 * kS);
  EXPECT_EQ(truth->warning, "");
  ASSERT_EQ(truth->map_from_base.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(truth->map_from_base[i].time_ns, (51 + i) * kS);
    EXPECT_NEAR(truth->map_from_base[i].map_from_base.yaw_rad, -2.0, 1e-12);
    EXPECT_EQ(truth->map_from_base[i].map_from_base.y_m, 2.0);
  }
  ASSERT_TRUE(truth->array_in_base_m.has_value());
  EXPECT_NEAR(truth->array_in_base_m->y, -0.2, 1e-12);
  EXPECT_NEAR(truth->array_in_base_m->z, 1.3, 1e-12);
}

TEST(ReadDriveTruth, KeepsWhatStandsBeforeADamage) {
  const std::string path = WriteDrive("cut.mcap");
  fs::resize_file(path, fs::file_size(path) - 20);
  const auto truth = ReadDriveTruth(path);
  ASSERT_TRUE(truth.ok()) << truth.status();
  EXPECT_EQ(truth->map_from_base.size(), 3u);
}

TEST(ReadDriveTruth, NamesWhatItRefuses) {
  const auto odom = ReadDriveTruth(WriteDrive("odom.mcap", {.frame = "odom"}));
  EXPECT_EQ(odom.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_TRUE(absl::StrContains(odom.status().message(), "odom.mcap"));
  EXPECT_FALSE(ReadDriveTruth(WriteDrive("nan.mcap", {.x_of_last_pose = std::nan("")})).ok());
  EXPECT_EQ(ReadDriveTruth(::testing::TempDir() + "missing.mcap").status().code(),
            absl::StatusCode::kNotFound);
  const auto none = ReadDriveTruth(WriteDrive("none.mcap", {.poses = false}));
  ASSERT_TRUE(none.ok());
  EXPECT_TRUE(none->map_from_base.empty());
}

// The robot of the shared drive goes round the whole room: every grill was in view at a range of 10
// m, none at 1 m.
TEST(ReadDriveTruth, SharedDriveSeesAllGrills) {
  const char* data = std::getenv("SOUNDMAP_DATA");
  const fs::path room =
      (data != nullptr ? fs::path(data) : fs::path(SOUNDMAP_SOURCE_DIR) / "../shared/data") /
      "grill_room";
  if (!fs::exists(room / "drive.mcap")) GTEST_SKIP() << "the shared data is not there";
  const auto drive = ReadDriveTruth((room / "drive.mcap").string());
  ASSERT_TRUE(drive.ok()) << drive.status();
  const auto scene = ReadTruthFile((room / "drive.truth.json").string());
  ASSERT_TRUE(scene.ok()) << scene.status();
  ASSERT_EQ(scene->sources.size(), 6u);
  ASSERT_TRUE(drive->array_in_base_m.has_value());
  const auto path = ArrayPath(drive->map_from_base, *drive->array_in_base_m);
  EXPECT_EQ(SourcesInView(*scene, path, drive->start_ns, 10.0), std::vector<bool>(6, true));
  EXPECT_EQ(SourcesInView(*scene, path, drive->start_ns, 1.0), std::vector<bool>(6, false));
}

}  // namespace
}  // namespace soundmap::cli
