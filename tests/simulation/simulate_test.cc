#include "sources/simulation/simulate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>

#include "foxglove/FrameTransforms.pb.h"
#include "foxglove/LaserScan.pb.h"
#include "foxglove/Odometry.pb.h"
#include "foxglove/PointCloud.pb.h"
#include "foxglove/PoseInFrame.pb.h"
#include "foxglove/RawAudio.pb.h"
#include "recording/foxglove_messages.h"
#include "recording/reader.h"
#include "tests/simulation/scene_texts.h"

namespace soundmap::simulation {
namespace {

std::string BytesOf(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::vector<recording::Message> MessagesOf(const std::string& path) {
  std::vector<recording::Message> messages;
  auto reader = recording::Reader::Open(path);
  EXPECT_TRUE(reader.ok()) << reader.status();
  for (;;) {
    auto message = (*reader)->Next();
    EXPECT_TRUE(message.ok()) << message.status();
    if (!message.ok() || !*message) return messages;
    messages.push_back(**message);
  }
}

std::string SceneFile(const std::string& folder, const nlohmann::json& scene) {
  const std::string path = folder + "/scene.json";
  std::ofstream(path) << scene.dump();
  return path;
}

nlohmann::json DrivingScene() {
  auto scene = StandingScene();
  scene["reverberation"] = {{"rt60_s", 0.3}};
  scene["furniture"] = {{{3.5, 3, 0}, {4.5, 4, 1}}};
  scene["sources"] = {{{"kind", "fan"},
                       {"position", {4, 3.5, 1}},
                       {"extent_m", 0.3},
                       {"level", 0.5},
                       {"on_s", 1.5},
                       {"off_s", 90}},
                      {{"kind", "motor"}, {"position", {0, 3, 1}}}};
  scene["array"] = {
      {"position_m", {0.1, 0, 1.2}}, {"rpy_deg", {0, 0, 90}}, {"shape", "cube"}, {"radius_m", 0.1}};
  scene["lidar"] = {{"swept", true}};
  scene["path"] = {{"way_points", {{2, 2}, {6, 2}, {6, 5}, {2, 5}}}, {"speed_mps", 1.0}};
  return scene;
}

TEST(Simulate, WritesEveryTopicInTheOrderOfTimeWithItsSchemaRateAndFrames) {
  const std::string folder = FreshFolder();
  const std::string out = folder + "/drive.mcap";
  SimulateOptions options;
  options.seconds = 3.0;
  const auto result = Simulate(SceneFile(folder, DrivingScene()), out, options);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->clipped_samples, 0);
  EXPECT_EQ(result->duration_s, 3.0);

  const auto messages = MessagesOf(out);
  EXPECT_EQ(static_cast<std::int64_t>(messages.size()), result->messages);
  const std::int64_t start_ns = 1'700'000'000'000'000'000;
  std::map<std::string, int> counts;
  std::int64_t last_ns = 0, next_audio_ns = start_ns;
  double peak = 0.0;
  for (const auto& message : messages) {
    ++counts[message.topic];
    EXPECT_GE(message.log_time_ns, last_ns);
    last_ns = message.log_time_ns;
    std::optional<std::int64_t> stamp_ns;
    if (message.topic == "/audio") {
      foxglove::RawAudio audio;
      ASSERT_TRUE(message.schema == "foxglove.RawAudio" && audio.ParseFromString(message.data));
      EXPECT_EQ(audio.format(), "pcm-s16");
      EXPECT_EQ(audio.sample_rate(), 16000u);
      EXPECT_EQ(audio.number_of_channels(), 8u);
      EXPECT_EQ(audio.data().size(), 8u * 2u * 800u);
      stamp_ns = recording::NsFromTimestamp(audio.timestamp());
      EXPECT_EQ(stamp_ns, next_audio_ns);
      next_audio_ns += 50'000'000;
      for (std::size_t i = 0; i + 1 < audio.data().size(); i += 2) {
        std::int16_t sample;
        std::memcpy(&sample, audio.data().data() + i, 2);
        peak = std::max(peak, std::abs(sample / 32768.0));
      }
    } else if (message.topic == "/lidar/points") {
      foxglove::PointCloud cloud;
      ASSERT_TRUE(message.schema == "foxglove.PointCloud" && cloud.ParseFromString(message.data));
      EXPECT_EQ(cloud.frame_id(), "lidar");
      ASSERT_EQ(cloud.fields_size(), 4);
      EXPECT_EQ(cloud.fields(3).name(), "time_offset_ns");
      stamp_ns = recording::NsFromTimestamp(cloud.timestamp());
    } else if (message.topic == "/scan") {
      foxglove::LaserScan scan;
      ASSERT_TRUE(message.schema == "foxglove.LaserScan" && scan.ParseFromString(message.data));
      EXPECT_EQ(scan.frame_id(), "laser");
      EXPECT_EQ(scan.ranges_size(), 541);
      EXPECT_NEAR(scan.start_angle(), -3 * M_PI / 4, 1e-9);
      EXPECT_NEAR(scan.end_angle(), 3 * M_PI / 4, 1e-9);
      stamp_ns = recording::NsFromTimestamp(scan.timestamp());
    } else if (message.topic == "/odom") {
      foxglove::Odometry odometry;
      ASSERT_TRUE(message.schema == "foxglove.Odometry" && odometry.ParseFromString(message.data));
      EXPECT_EQ(odometry.frame_id(), "odom");
      EXPECT_EQ(odometry.body_frame_id(), "base_link");
      stamp_ns = recording::NsFromTimestamp(odometry.timestamp());
    } else if (message.topic == "/ground_truth/pose") {
      foxglove::PoseInFrame pose;
      ASSERT_TRUE(message.schema == "foxglove.PoseInFrame" && pose.ParseFromString(message.data));
      EXPECT_EQ(pose.frame_id(), "map");
      stamp_ns = recording::NsFromTimestamp(pose.timestamp());
    } else {
      ASSERT_EQ(message.topic, "/tf_static");
      foxglove::FrameTransforms transforms;
      ASSERT_TRUE(transforms.ParseFromString(message.data));
      ASSERT_EQ(transforms.transforms_size(), 3 + 8);
      EXPECT_EQ(transforms.transforms(0).child_frame_id(), "mic_array");
      EXPECT_NEAR(transforms.transforms(0).rotation().z(), std::sqrt(0.5), 1e-9);
      EXPECT_EQ(transforms.transforms(10).child_frame_id(), "mic_7");
      EXPECT_EQ(transforms.transforms(10).parent_frame_id(), "mic_array");
      continue;
    }
    EXPECT_EQ(stamp_ns, message.log_time_ns);
  }
  EXPECT_EQ(counts["/tf_static"], 1);
  EXPECT_EQ(counts["/audio"], 60);
  EXPECT_EQ(counts["/lidar/points"], 6);
  EXPECT_EQ(counts["/scan"], 30);
  EXPECT_EQ(counts["/odom"], 60);
  EXPECT_EQ(counts["/ground_truth/pose"], 30);
  EXPECT_GT(peak, 0.08);
  EXPECT_LT(peak, 0.5);
}

TEST(Simulate, TruthSaysWhatTheSceneHolds) {
  const std::string folder = FreshFolder();
  SimulateOptions options;
  options.seconds = 0.2;
  const auto scene = DrivingScene();
  const auto result = Simulate(SceneFile(folder, scene), folder + "/a.b.mcap", options);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->truth_path, folder + "/a.b.truth.json");
  const auto truth = nlohmann::json::parse(BytesOf(result->truth_path));
  EXPECT_EQ(truth["frame"], "map");
  EXPECT_EQ(truth["room"], nlohmann::json({8, 7, 3}));
  EXPECT_EQ(truth["obstacles"], scene["furniture"]);
  ASSERT_EQ(truth["sources"].size(), 2u);
  EXPECT_EQ(truth["sources"][0], scene["sources"][0]);
  EXPECT_EQ(
      truth["sources"][1],
      nlohmann::json({{"kind", "motor"}, {"position", {0, 3, 1}}, {"extent_m", 0}, {"level", 1}}));
  foxglove::PoseInFrame first;
  for (const auto& message : MessagesOf(folder + "/a.b.mcap")) {
    if (message.topic != "/ground_truth/pose") continue;
    first.ParseFromString(message.data);
    break;
  }
  EXPECT_NEAR(truth["start_pose"][0], first.pose().position().x(), 1e-9);
  EXPECT_NEAR(truth["start_pose"][1], first.pose().position().y(), 1e-9);
  EXPECT_NEAR(std::sin(truth["start_pose"][2].get<double>() / 2), first.pose().orientation().z(),
              1e-9);
}

TEST(Simulate, TheSameSceneGivesTheSameBytesAndAnotherSeedOthers) {
  const std::string folder = FreshFolder();
  SimulateOptions options;
  options.seconds = 1.0;
  auto scene = DrivingScene();
  ASSERT_TRUE(Simulate(SceneFile(folder, scene), folder + "/1.mcap", options).ok());
  ASSERT_TRUE(Simulate(SceneFile(folder, scene), folder + "/2.mcap", options).ok());
  scene["seed"] = 99;
  ASSERT_TRUE(Simulate(SceneFile(folder, scene), folder + "/3.mcap", options).ok());
  const std::string first = BytesOf(folder + "/1.mcap");
  EXPECT_GT(first.size(), 10000u);
  EXPECT_TRUE(first == BytesOf(folder + "/2.mcap"));
  EXPECT_FALSE(first == BytesOf(folder + "/3.mcap"));
  EXPECT_EQ(BytesOf(folder + "/1.truth.json"), BytesOf(folder + "/2.truth.json"));
}

TEST(Simulate, AMappingDriveTakesTheSamePathWithoutAudio) {
  const std::string folder = FreshFolder();
  SimulateOptions options;
  options.seconds = 2.0;
  ASSERT_TRUE(Simulate(SceneFile(folder, DrivingScene()), folder + "/listen.mcap", options).ok());
  options.mapping = true;
  ASSERT_TRUE(Simulate(SceneFile(folder, DrivingScene()), folder + "/map.mcap", options).ok());
  const auto poses = [&](const std::string& name) {
    std::vector<std::string> poses;
    for (const auto& message : MessagesOf(folder + name)) {
      EXPECT_TRUE(name == "/listen.mcap" || message.topic != "/audio");
      if (message.topic != "/ground_truth/pose") continue;
      foxglove::PoseInFrame pose;
      pose.ParseFromString(message.data);
      poses.push_back(pose.pose().SerializeAsString());
    }
    return poses;
  };
  EXPECT_EQ(poses("/listen.mcap"), poses("/map.mcap"));
}

// 1000 ppm: stamps of 1000 s of samples would run 1 s short; in 4 s, 4 ms.
TEST(Simulate, ADriftingAudioClockStampsItsChunksInTrueTime) {
  const std::string folder = FreshFolder();
  auto scene = DrivingScene();
  scene["audio"] = {{"clock_drift_ppm", 1000}};
  SimulateOptions options;
  options.seconds = 4.0;
  ASSERT_TRUE(Simulate(SceneFile(folder, scene), folder + "/d.mcap", options).ok());
  int chunk = 0;
  for (const auto& message : MessagesOf(folder + "/d.mcap")) {
    if (message.topic != "/audio") continue;
    EXPECT_NEAR((message.log_time_ns - 1'700'000'000'000'000'000) * 1e-9, chunk * 0.05 / 1.001,
                1e-8);
    ++chunk;
  }
  EXPECT_EQ(chunk, 81);
}

TEST(Simulate, ReportsWhatItCannotDo) {
  const std::string folder = FreshFolder();
  const std::string scene = SceneFile(folder, DrivingScene());
  SimulateOptions options;
  options.seconds = 0.2;
  EXPECT_THAT(std::string(Simulate(scene, "/nonexistent/a.mcap", options).status().message()),
              ::testing::HasSubstr("/nonexistent/a.mcap"));
  ASSERT_TRUE(Simulate(scene, folder + "/a.mcap", options).ok());
  EXPECT_FALSE(Simulate(scene, folder + "/a.mcap", options).ok());  // it exists
  EXPECT_FALSE(Simulate("no_such_scene", folder + "/b.mcap", options).ok());
  options.seconds = -1.0;
  EXPECT_FALSE(Simulate(scene, folder + "/c.mcap", options).ok());
  auto no_wav = DrivingScene();
  no_wav["sources"][0]["kind"] = "missing.wav";
  options.seconds = 0.2;
  EXPECT_THAT(
      std::string(
          Simulate(SceneFile(folder, no_wav), folder + "/d.mcap", options).status().message()),
      ::testing::HasSubstr(folder + "/missing.wav"));
  EXPECT_FALSE(std::filesystem::exists(folder + "/d.mcap"));
}

}  // namespace
}  // namespace soundmap::simulation
