#include "sources/replay/replay.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "recording/foxglove_messages.h"

namespace soundmap::sources {
namespace {

using recording::MakeFrameTransform;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

const Eigen::Isometry3d kHere = Eigen::Isometry3d::Identity();

struct DriveParts {
  int microphones = 2;
  bool lidar_mount = true;
  bool audio = true;
  bool lidar = true;
  std::string audio_topic = "/audio";
  bool close = true;
};

std::string MakeDrive(const DriveParts& parts) {
  const auto& test = *testing::UnitTest::GetInstance()->current_test_info();
  static int count = 0;
  const std::string path =
      testing::TempDir() + test.name() + "." + std::to_string(count++) + ".mcap";
  std::filesystem::remove(path);
  auto writer = recording::Writer::Create(path, {}).value();
  std::int64_t time_ns = 1'000'000'000;
  const auto write = [&](std::string_view topic, const google::protobuf::Message& message) {
    EXPECT_TRUE(recording::WriteMessage(*writer, topic, time_ns += 1000, 0, message).ok());
  };
  if (parts.audio) {
    write(parts.audio_topic,
          recording::MakeRawAudio(time_ns, 16000, 2, std::vector<std::int16_t>(8)));
  }
  write("/ground_truth/pose", recording::MakePoseInFrame(time_ns, "map", kHere));
  if (parts.lidar) write("/lidar/points", recording::MakePointCloud(time_ns, {}));
  EXPECT_TRUE(writer->Flush(false).ok());
  foxglove::FrameTransforms transforms;
  *transforms.add_transforms() = MakeFrameTransform(0, "base_link", "mic_array", kHere);
  *transforms.add_transforms() = MakeFrameTransform(0, "base_link", "laser", kHere);
  if (parts.lidar_mount) {
    *transforms.add_transforms() = MakeFrameTransform(0, "base_link", "lidar", kHere);
  }
  for (int i = 0; i < parts.microphones; ++i) {
    *transforms.add_transforms() =
        MakeFrameTransform(0, "mic_array", "mic_" + std::to_string(i), kHere);
  }
  write("/tf_static", transforms);
  write("/scan", recording::MakeLaserScan(time_ns, -1, 1, std::vector<double>{1.0}));
  write("/odom", recording::MakeOdometry(time_ns, kHere));
  EXPECT_TRUE(writer->Flush(false).ok());
  write("/odom", recording::MakeOdometry(time_ns, kHere));
  if (parts.close) {
    EXPECT_TRUE(writer->Close().ok());
  }
  return path;
}

std::vector<Sensor> Sensors(Replay& replay) {
  std::vector<Sensor> sensors;
  while (true) {
    auto frame = replay.Next();
    EXPECT_TRUE(frame.ok()) << frame.status();
    if (!frame.ok() || !*frame) return sensors;
    sensors.push_back((*frame)->sensor);
  }
}

TEST(Replay, GivesSensorFramesAndNothingElse) {
  auto replay = Replay::Open(MakeDrive({}));
  ASSERT_TRUE(replay.ok()) << replay.status();
  EXPECT_EQ((*replay)->survey().sensor_count(), 5);
  EXPECT_THAT(Sensors(**replay), ElementsAre(Sensor::kAudio, Sensor::kLidar, Sensor::kLaser,
                                             Sensor::kOdometry, Sensor::kOdometry));
  EXPECT_THAT((*replay)->ListeningWarnings(), IsEmpty());
  ASSERT_TRUE((*replay)->Seek(3).ok());
  EXPECT_THAT(Sensors(**replay), ElementsAre(Sensor::kOdometry, Sensor::kOdometry));
  ASSERT_TRUE((*replay)->Seek(5).ok());
  EXPECT_THAT(Sensors(**replay), IsEmpty());
  EXPECT_EQ((*replay)->Seek(6).code(), absl::StatusCode::kOutOfRange);
}

TEST(Replay, ADamagedDriveEndsAtTheDamage) {
  auto replay = Replay::Open(MakeDrive({.close = false}));
  ASSERT_TRUE(replay.ok()) << replay.status();
  EXPECT_EQ((*replay)->survey().damage.code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(Sensors(**replay).size(), 4u);
}

TEST(Replay, SaysWhatIsMissing) {
  const auto error = [](const DriveParts& parts) {
    return std::string(Replay::Open(MakeDrive(parts)).status().message());
  };
  EXPECT_THAT(error({.microphones = 1}), HasSubstr("mic_1"));
  EXPECT_THAT(error({.microphones = 0}), HasSubstr("no microphone"));
  EXPECT_THAT(error({.microphones = 3}), HasSubstr("mic_2"));
  EXPECT_THAT(error({.lidar_mount = false}), AllOf(HasSubstr("/tf_static"), HasSubstr("lidar")));
  EXPECT_EQ(error({.lidar_mount = false, .lidar = false}), "");
}

TEST(Replay, WarnsOfWhatAListeningDriveLacks) {
  const auto warnings = [](const DriveParts& parts) {
    return Replay::Open(MakeDrive(parts)).value()->ListeningWarnings();
  };
  EXPECT_THAT(warnings({.audio = false}),
              ElementsAre(AllOf(HasSubstr("no audio"), HasSubstr("/audio"))));
  EXPECT_THAT(warnings({.lidar = false}), ElementsAre(HasSubstr("/lidar/points")));
}

TEST(Replay, TakesOtherTopics) {
  const std::string path = MakeDrive({.audio_topic = "/front/sound"});
  EXPECT_EQ(Replay::Open(path).value()->survey().audio_count, 0);
  recording::DriveTopics topics;
  topics.audio = "/front/sound";
  auto replay = Replay::Open(path, topics).value();
  EXPECT_EQ(replay->survey().audio_count, 1);
  EXPECT_EQ(Sensors(*replay).size(), 5u);
}

TEST(Replay, ItsSessionDependsOnWhatItIs) {
  const std::string path = MakeDrive({});
  const auto replay = Replay::Open(path).value();
  const std::string id = replay->SessionId("site", "robot", "listening");
  EXPECT_THAT(id, testing::MatchesRegex("r-[0-9a-f]{16}"));
  const std::string copy = path + ".copy";
  std::filesystem::copy_file(path, copy, std::filesystem::copy_options::overwrite_existing);
  EXPECT_EQ(Replay::Open(copy).value()->SessionId("site", "robot", "listening"), id);
  EXPECT_NE(replay->SessionId("site2", "robot", "listening"), id);
  EXPECT_NE(replay->SessionId("siter", "obot", "listening"), id);
  EXPECT_NE(replay->SessionId("site", "robot", "mapping"), id);
  EXPECT_NE(
      Replay::Open(MakeDrive({.lidar = false})).value()->SessionId("site", "robot", "listening"),
      id);
}

TEST(Replay, RefusesAFileWithoutSensors) {
  const std::string path = MakeDrive({});
  recording::DriveTopics topics{
      .transforms = "/tf_static", .audio = "/a", .lidar = "/b", .laser = "/c", .odometry = "/d"};
  EXPECT_THAT(std::string(Replay::Open(path, topics).status().message()),
              HasSubstr("no message on /a"));
  EXPECT_EQ(Replay::Open(path + ".none").status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace soundmap::sources
