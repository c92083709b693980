#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>

#include "recording/drive.h"
#include "tests/recording/recording_files.h"

namespace soundmap::recording {
namespace {

// Recordings made by another program.
class SampleDrive : public testing::Test {
 protected:
  void SetUp() override {
    const char* data = std::getenv("SOUNDMAP_DATA");
    folder_ = std::string(data != nullptr ? data : SOUNDMAP_SOURCE_DIR "/../shared/data") +
              "/grill_room/";
    if (!std::filesystem::exists(folder_ + "drive.mcap")) {
      GTEST_SKIP() << "the sample drive is not there: " << folder_ << "drive.mcap";
    }
  }

  std::string folder_;
};

// The message with every field that this program's declaration does not know left out.
template <typename T>
std::string KnownPart(const std::string& data) {
  T message;
  EXPECT_TRUE(message.ParseFromString(data));
  message.DiscardUnknownFields();
  return message.SerializeAsString();
}

TEST_F(SampleDrive, IsReadInFull) {
  const std::map<std::string, std::map<std::string, int>> expected = {
      {"drive.mcap",
       {{"/tf_static", 1},
        {"/audio", 1680},
        {"/odom", 1680},
        {"/scan", 840},
        {"/lidar/points", 168},
        {"/ground_truth/pose", 840}}},
      {"mapping.mcap",
       {{"/tf_static", 1},
        {"/odom", 840},
        {"/scan", 420},
        {"/lidar/points", 126},
        {"/ground_truth/pose", 420}}}};
  for (const auto& [name, counts] : expected) {
    const Delivered delivered = ReadAll(folder_ + name);
    EXPECT_TRUE(delivered.status.ok()) << delivered.status;
    std::map<std::string, int> seen;
    for (const Message& message : delivered.messages) ++seen[message.topic];
    EXPECT_EQ(seen, counts) << name;
  }
}

TEST_F(SampleDrive, HoldsNothingThatTheDeclarationsDoNotKnow) {
  const Delivered delivered = ReadAll(folder_ + "drive.mcap");
  for (const Message& message : delivered.messages) {
    std::string known;
    if (message.topic == "/tf_static") known = KnownPart<foxglove::FrameTransforms>(message.data);
    if (message.topic == "/audio") known = KnownPart<foxglove::RawAudio>(message.data);
    if (message.topic == "/odom") known = KnownPart<foxglove::Odometry>(message.data);
    if (message.topic == "/scan") known = KnownPart<foxglove::LaserScan>(message.data);
    if (message.topic == "/lidar/points") known = KnownPart<foxglove::PointCloud>(message.data);
    if (message.topic == "/ground_truth/pose")
      known = KnownPart<foxglove::PoseInFrame>(message.data);
    ASSERT_EQ(known.size(), message.data.size()) << message;
  }
}

TEST_F(SampleDrive, TellsWhereItsSensorsAre) {
  const auto survey = SurveyDrive(folder_ + "drive.mcap");
  ASSERT_TRUE(survey.ok()) << survey.status();
  EXPECT_EQ(survey->audio_sample_rate_hz, 16000);
  EXPECT_EQ(survey->audio_channels, 16);
  const auto robot = MakeRobotModel(survey->transforms, survey->audio_channels);
  ASSERT_TRUE(robot.ok()) << robot.status();
  EXPECT_TRUE(robot->base_from_array->translation().isApprox(Eigen::Vector3d(0.1, 0.0, 1.2)));
  EXPECT_TRUE(robot->base_from_lidar->translation().isApprox(Eigen::Vector3d(0.0, 0.0, 1.45)));
  EXPECT_TRUE(robot->base_from_laser->translation().isApprox(Eigen::Vector3d(0.2, 0.0, 0.3)));
  ASSERT_EQ(robot->mic_in_array_m.size(), 16u);
  EXPECT_TRUE(robot->mic_in_array_m[0].isApprox(Eigen::Vector3d(0.15, 0.0, 0.0)));

  const auto truth = ReadGroundTruth(folder_ + "drive.mcap");
  ASSERT_TRUE(truth.ok()) << truth.status();
  ASSERT_EQ(truth->size(), 840u);
  EXPECT_EQ((*truth)[1].time_ns, 1'000'100'000'000);
}

}  // namespace
}  // namespace soundmap::recording
