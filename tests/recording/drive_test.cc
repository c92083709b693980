#include "recording/drive.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "recording/foxglove_messages.h"
#include "tests/recording/recording_files.h"

namespace soundmap::recording {
namespace {

using testing::HasSubstr;

Eigen::Isometry3d Isometry(double x, double y, double z, double angle_rad,
                           const Eigen::Vector3d& axis) {
  Eigen::Isometry3d isometry = Eigen::Isometry3d::Identity();
  isometry.linear() = Eigen::AngleAxisd(angle_rad, axis.normalized()).toRotationMatrix();
  isometry.translation() << x, y, z;
  return isometry;
}

std::string Text(const absl::Status& status) { return std::string(status.message()); }

TEST(TransformTree, FollowsChainsGivenInAnyOrder) {
  const Eigen::Isometry3d base_from_mast = Isometry(0.1, 0.2, 1.0, 0.3, {0, 0, 1});
  const Eigen::Isometry3d mast_from_array = Isometry(0, 0, 0.5, -1.1, {1, 2, 0});
  const Eigen::Isometry3d array_from_mic = Isometry(0.05, -0.02, 0.01, 2.0, {0, 1, 1});
  std::vector<foxglove::FrameTransform> transforms = {
      MakeFrameTransform(0, "base_link", "mast", base_from_mast),
      MakeFrameTransform(0, "mast", "mic_array", mast_from_array),
      MakeFrameTransform(0, "mic_array", "mic_0", array_from_mic)};
  std::sort(transforms.begin(), transforms.end(),
            [](const auto& a, const auto& b) { return a.child_frame_id() < b.child_frame_id(); });
  do {
    TransformTree tree;
    for (const auto& transform : transforms) ASSERT_TRUE(tree.Add(transform).ok());
    EXPECT_TRUE(tree.Find("base_link", "mic_0")
                    ->isApprox(base_from_mast * mast_from_array * array_from_mic, 1e-12));
    EXPECT_TRUE(
        tree.Find("mic_0", "mast")->isApprox((mast_from_array * array_from_mic).inverse(), 1e-12));
    EXPECT_FALSE(tree.Find("base_link", "lidar").has_value());
  } while (std::next_permutation(
      transforms.begin(), transforms.end(),
      [](const auto& a, const auto& b) { return a.child_frame_id() < b.child_frame_id(); }));
}

TEST(TransformTree, RefusesWhatIsNoTree) {
  const Eigen::Isometry3d up = Isometry(0, 0, 1, 0, {0, 0, 1});
  TransformTree tree;
  ASSERT_TRUE(tree.Add(MakeFrameTransform(0, "a", "b", up)).ok());
  ASSERT_TRUE(tree.Add(MakeFrameTransform(0, "b", "c", up)).ok());
  EXPECT_TRUE(tree.Add(MakeFrameTransform(9, "a", "b", up)).ok()) << "a repetition";
  EXPECT_THAT(Text(tree.Add(MakeFrameTransform(0, "c", "a", up))), HasSubstr("loop"));
  EXPECT_THAT(Text(tree.Add(MakeFrameTransform(0, "d", "d", up))), HasSubstr("loop"));
  EXPECT_THAT(Text(tree.Add(MakeFrameTransform(0, "x", "b", up))), HasSubstr("contradicts"));
  EXPECT_THAT(Text(tree.Add(MakeFrameTransform(0, "a", "", up))), HasSubstr("name"));
  foxglove::FrameTransform no_rotation = MakeFrameTransform(0, "a", "e", up);
  no_rotation.clear_rotation();
  EXPECT_THAT(Text(tree.Add(no_rotation)), HasSubstr("rotation"));
  foxglove::FrameTransform nan = MakeFrameTransform(0, "a", "e", up);
  nan.mutable_translation()->set_x(std::numeric_limits<double>::quiet_NaN());
  EXPECT_THAT(Text(tree.Add(nan)), HasSubstr("finite"));
}

TransformTree ArrayTree(std::vector<int> microphones) {
  TransformTree tree;
  EXPECT_TRUE(
      tree.Add(MakeFrameTransform(0, "base_link", "mic_array", Isometry(0, 0, 1, 0, {0, 0, 1})))
          .ok());
  for (const int i : microphones) {
    EXPECT_TRUE(tree.Add(MakeFrameTransform(0, "mic_array", "mic_" + std::to_string(i),
                                            Isometry(0.1 * i, 0, 0, 0, {0, 0, 1})))
                    .ok());
  }
  return tree;
}

TEST(RobotModel, PlacesTheMicrophonesInChannelOrder) {
  const auto model = MakeRobotModel(ArrayTree({10, 2, 0, 1, 3, 9, 8, 7, 6, 5, 4}), 11);
  ASSERT_TRUE(model.ok()) << model.status();
  ASSERT_EQ(model->mic_in_array_m.size(), 11u);
  for (int i = 0; i < 11; ++i) EXPECT_NEAR(model->mic_in_array_m[i].x(), 0.1 * i, 1e-12);
  EXPECT_TRUE(model->base_from_array.has_value());
  EXPECT_FALSE(model->base_from_lidar.has_value());
}

TEST(RobotModel, NamesWhatIsMissing) {
  EXPECT_THAT(Text(MakeRobotModel(ArrayTree({0, 1, 2}), 16).status()),
              testing::AllOf(HasSubstr("3 microphones"), HasSubstr("16"), HasSubstr("mic_3 ")));
  EXPECT_THAT(Text(MakeRobotModel(ArrayTree({0, 2}), 3).status()), HasSubstr("mic_1 "));
  EXPECT_THAT(Text(MakeRobotModel(ArrayTree({}), 16).status()), HasSubstr("no microphone"));
  EXPECT_THAT(Text(MakeRobotModel(TransformTree(), 16).status()), HasSubstr("no microphone"));
  EXPECT_THAT(Text(MakeRobotModel(ArrayTree({0, 1, 2}), 2).status()), HasSubstr("mic_2"));
  TransformTree floating;
  ASSERT_TRUE(
      floating.Add(MakeFrameTransform(0, "mic_array", "mic_0", Eigen::Isometry3d::Identity()))
          .ok());
  EXPECT_THAT(Text(MakeRobotModel(floating, 1).status()), HasSubstr("base_link"));
  EXPECT_TRUE(MakeRobotModel(TransformTree(), 0).ok()) << "without audio nothing is needed";
}

TEST(Messages, PointCloudIsPackedLittleEndian) {
  const std::vector<Eigen::Vector3f> points = {{1.5f, -2.0f, 3.25f}, {0.0f, 1e-3f, 7.0f}};
  const std::vector<std::uint32_t> offsets_ns = {5, 70'000'000};
  const foxglove::PointCloud plain = MakePointCloud(1'000'000'007, points);
  EXPECT_EQ(plain.point_stride(), 12u);
  EXPECT_EQ(plain.fields_size(), 3);
  const foxglove::PointCloud timed = MakePointCloud(1'000'000'007, points, offsets_ns);
  ASSERT_EQ(timed.data().size(), 32u);
  for (int i = 0; i < 2; ++i) {
    float xyz[3];
    std::uint32_t offset_ns;
    std::memcpy(xyz, timed.data().data() + 16 * i, 12);
    std::memcpy(&offset_ns, timed.data().data() + 16 * i + 12, 4);
    EXPECT_EQ(Eigen::Vector3f(xyz[0], xyz[1], xyz[2]), points[i]);
    EXPECT_EQ(offset_ns, offsets_ns[i]);
    std::memcpy(xyz, plain.data().data() + 12 * i, 12);
    EXPECT_EQ(Eigen::Vector3f(xyz[0], xyz[1], xyz[2]), points[i]);
  }
  EXPECT_EQ(timed.timestamp().seconds(), 1);
  EXPECT_EQ(timed.timestamp().nanos(), 7);
}

TEST(Messages, RawAudioIsInterleavedLittleEndian) {
  const std::vector<std::int16_t> samples = {1, -1, 0x1234, -32768};
  const foxglove::RawAudio audio = MakeRawAudio(5, 16000, 2, samples);
  EXPECT_EQ(audio.data(), std::string("\x01\0\xff\xff\x34\x12\0\x80", 8));
  EXPECT_EQ(audio.sample_rate(), 16000u);
  EXPECT_EQ(audio.number_of_channels(), 2u);
}

TEST(Messages, TimesComeBackAndImpossibleOnesDoNot) {
  for (const std::int64_t time_ns :
       {std::int64_t{0}, std::int64_t{999'999'999}, std::int64_t{1'700'000'000'123'456'789}}) {
    EXPECT_EQ(NsFromTimestamp(TimestampFromNs(time_ns)), time_ns);
  }
  google::protobuf::Timestamp timestamp;
  timestamp.set_seconds(std::numeric_limits<std::int64_t>::max());
  EXPECT_FALSE(NsFromTimestamp(timestamp).has_value());
  timestamp.set_seconds(-1);
  EXPECT_FALSE(NsFromTimestamp(timestamp).has_value());
  timestamp.set_seconds(1);
  timestamp.set_nanos(1'000'000'000);
  EXPECT_FALSE(NsFromTimestamp(timestamp).has_value());
}

class Survey : public testing::Test {
 protected:
  Survey() : path_(FreshPath("mcap")), writer_(Writer::Create(path_, {}).value()) {}

  void Add(std::string_view topic, std::int64_t time_ns, const google::protobuf::Message& message) {
    ASSERT_TRUE(WriteMessage(*writer_, topic, time_ns, 0, message).ok());
  }
  absl::StatusOr<DriveSurvey> Result(const DriveTopics& topics = {}) {
    EXPECT_TRUE(writer_->Close().ok());
    return SurveyDrive(path_, topics);
  }

  std::string path_;
  std::unique_ptr<Writer> writer_;
};

TEST_F(Survey, CountsSensorsAndFindsTransformsAnywhere) {
  const Eigen::Isometry3d pose = Isometry(1, 2, 0, 0.5, {0, 0, 1});
  Add("/ground_truth/pose", 1, MakePoseInFrame(1, "map", pose));
  Add("/their/audio", 20, MakeRawAudio(20, 48000, 8, std::vector<std::int16_t>(80)));
  Add("/audio", 15, MakeRawAudio(15, 16000, 2, {}));
  Add("/scan", 10, MakeLaserScan(10, -1, 1, std::vector<double>{1, 2}));
  Add("/odom", 30, MakeOdometry(30, pose));
  foxglove::FrameTransforms transforms;
  *transforms.add_transforms() = MakeFrameTransform(0, "base_link", "laser", pose);
  Add("/tf_static", 31, transforms);
  DriveTopics topics;
  topics.audio = "/their/audio";
  const auto survey = Result(topics);
  ASSERT_TRUE(survey.ok()) << survey.status();
  EXPECT_TRUE(survey->damage.ok());
  EXPECT_EQ(survey->audio_count, 1);
  EXPECT_EQ(survey->lidar_count, 0);
  EXPECT_EQ(survey->laser_count, 1);
  EXPECT_EQ(survey->odometry_count, 1);
  EXPECT_EQ(survey->first_log_time_ns, 10);
  EXPECT_EQ(survey->last_log_time_ns, 30);
  EXPECT_EQ(survey->audio_sample_rate_hz, 48000);
  EXPECT_EQ(survey->audio_channels, 8);
  EXPECT_TRUE(survey->transforms.Find("base_link", "laser")->isApprox(pose, 1e-12));

  const auto truth = ReadGroundTruth(path_);
  ASSERT_TRUE(truth.ok()) << truth.status();
  ASSERT_EQ(truth->size(), 1u);
  EXPECT_TRUE((*truth)[0].map_from_base.isApprox(pose, 1e-12));
}

TEST_F(Survey, RefusesAnotherSchema) {
  Add("/audio", 1, MakeLaserScan(1, -1, 1, {}));
  EXPECT_THAT(Text(Result().status()),
              testing::AllOf(HasSubstr("/audio"), HasSubstr("foxglove.LaserScan")));
}

TEST_F(Survey, RefusesLossyAudio) {
  foxglove::RawAudio audio = MakeRawAudio(1, 16000, 2, {});
  audio.set_format("opus");
  Add("/audio", 1, audio);
  EXPECT_THAT(Text(Result().status()), HasSubstr("'opus'"));
}

TEST_F(Survey, OfADamagedDriveHoldsUpToTheDamage) {
  Add("/scan", 10, MakeLaserScan(10, -1, 1, {}));
  ASSERT_TRUE(writer_->Flush(false).ok());
  Add("/scan", 11, MakeLaserScan(11, -1, 1, {}));
  writer_.reset();
  const auto survey = SurveyDrive(path_);
  ASSERT_TRUE(survey.ok());
  EXPECT_EQ(survey->laser_count, 1);
  EXPECT_EQ(survey->damage.code(), absl::StatusCode::kDataLoss);
}

}  // namespace
}  // namespace soundmap::recording
