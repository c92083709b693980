#include "api/decode_frame.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "recording/foxglove_messages.h"

namespace soundmap::api {
namespace {

using ::testing::HasSubstr;

constexpr std::int64_t kStamp_ns = 1'700'000'000'123'456'789;

frames::Calibration TwoMicrophones() {
  frames::Calibration calibration;
  calibration.mic_in_array_m = {{0.0, 0.0, 0.0}, {0.1, 0.0, 0.0}};
  calibration.audio_sample_rate_hz = 16000;
  return calibration;
}

absl::StatusOr<frames::Frame> Decode(const google::protobuf::Message& message) {
  return DecodeFrame(message.GetDescriptor()->full_name(), message.SerializeAsString(),
                     TwoMicrophones());
}

void ExpectRefused(const google::protobuf::Message& message, const std::string& says) {
  const auto frame = Decode(message);
  ASSERT_FALSE(frame.ok()) << says;
  EXPECT_EQ(frame.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(frame.status().message()), HasSubstr(says));
}

TEST(DecodeFrame, AudioKeepsEverySample) {
  const std::int16_t samples[] = {1, -2, 3, -32768, 32767, 0};
  const auto frame = Decode(recording::MakeRawAudio(kStamp_ns, 16000, 2, samples));
  ASSERT_TRUE(frame.ok()) << frame.status();
  const auto& audio = std::get<frames::AudioBlock>(*frame);
  EXPECT_EQ(audio.stamp_ns, kStamp_ns);
  EXPECT_EQ(audio.samples_per_channel(), 3);
  EXPECT_THAT(audio.samples, ::testing::ElementsAreArray(samples));
}

TEST(DecodeFrame, AudioThatDoesNotFitTheCalibrationIsRefused) {
  const std::int16_t samples[6] = {};
  ExpectRefused(recording::MakeRawAudio(kStamp_ns, 48000, 2, samples), "48000 Hz");
  ExpectRefused(recording::MakeRawAudio(kStamp_ns, 16000, 3, samples), "3 channels");
  ExpectRefused(recording::MakeRawAudio(kStamp_ns, 16000, 2, {}), "0 bytes");
  foxglove::RawAudio none = recording::MakeRawAudio(kStamp_ns, 16000, 2, samples);
  none.set_number_of_channels(0);
  ExpectRefused(none, "0 channels");
  foxglove::RawAudio odd = recording::MakeRawAudio(kStamp_ns, 16000, 2, samples);
  odd.mutable_data()->pop_back();
  ExpectRefused(odd, "whole samples");
  foxglove::RawAudio lossy = recording::MakeRawAudio(kStamp_ns, 16000, 2, samples);
  lossy.set_format("opus");
  ExpectRefused(lossy, "opus");
  foxglove::RawAudio early = recording::MakeRawAudio(kStamp_ns, 16000, 2, samples);
  early.mutable_timestamp()->set_seconds(-5);
  ExpectRefused(early, "1970");
}

TEST(DecodeFrame, LidarPointsWithoutReturnAreLeftOut) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const Eigen::Vector3f points[] = {{1, 2, 3}, {nan, 0, 0}, {0, 0, 0}, {4, 5, 6}};
  const std::uint32_t offsets_ns[] = {10, 20, 30, 40};
  const auto frame = Decode(recording::MakePointCloud(kStamp_ns, points, offsets_ns));
  ASSERT_TRUE(frame.ok()) << frame.status();
  const auto& scan = std::get<frames::LidarScan>(*frame);
  ASSERT_EQ(scan.point_in_lidar.size(), 2u);
  EXPECT_EQ(scan.point_in_lidar[1], Eigen::Vector3f(4, 5, 6));
  EXPECT_THAT(scan.time_offset_ns, ::testing::ElementsAre(10u, 40u));
}

TEST(DecodeFrame, PointLayoutsThatCannotBeAreRefused) {
  const Eigen::Vector3f points[] = {{1, 2, 3}};
  foxglove::PointCloud cloud = recording::MakePointCloud(kStamp_ns, points);
  foxglove::PointCloud beyond = cloud;
  beyond.mutable_fields(0)->set_offset(std::numeric_limits<std::uint32_t>::max());
  ExpectRefused(beyond, "stride");
  foxglove::PointCloud bytes = cloud;
  bytes.mutable_fields(1)->set_type(foxglove::PackedElementField::UINT8);
  ExpectRefused(bytes, "wrong type");
  foxglove::PointCloud flat = cloud;
  flat.mutable_fields()->RemoveLast();
  ExpectRefused(flat, "lacks");
  foxglove::PointCloud no_stride = cloud;
  no_stride.set_point_stride(0);
  ExpectRefused(no_stride, "stride");
  foxglove::PointCloud partial = cloud;
  partial.mutable_data()->pop_back();
  ExpectRefused(partial, "bytes");
}

TEST(DecodeFrame, LaserBeamsWithoutReturnAreMarked) {
  const double inf = std::numeric_limits<double>::infinity();
  const double ranges_m[] = {1.0, inf, 0.0, -1.0, std::nan(""), 2.0};
  const auto frame = Decode(recording::MakeLaserScan(kStamp_ns, -1.0, 1.5, ranges_m));
  ASSERT_TRUE(frame.ok()) << frame.status();
  const auto& scan = std::get<frames::LaserScan>(*frame);
  EXPECT_DOUBLE_EQ(scan.angle_increment_rad, 0.5);
  ASSERT_EQ(scan.range_m.size(), 6u);
  EXPECT_FLOAT_EQ(scan.range_m[0], 1.0f);
  for (int i = 1; i < 5; ++i) EXPECT_TRUE(std::isnan(scan.range_m[i])) << i;
  ExpectRefused(recording::MakeLaserScan(kStamp_ns, inf, 1.0, ranges_m), "angle");
}

TEST(DecodeFrame, OdometryIsProjectedToTheFloor) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translate(Eigen::Vector3d(1.0, 2.0, 0.3));
  pose.rotate(Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ()));
  const auto frame = Decode(recording::MakeOdometry(kStamp_ns, pose));
  ASSERT_TRUE(frame.ok()) << frame.status();
  const auto& odometry = std::get<frames::Odometry>(*frame);
  EXPECT_DOUBLE_EQ(odometry.odom_from_base.x_m, 1.0);
  EXPECT_DOUBLE_EQ(odometry.odom_from_base.y_m, 2.0);
  EXPECT_NEAR(odometry.odom_from_base.yaw_rad, 0.7, 1e-12);
  foxglove::Odometry bad = recording::MakeOdometry(kStamp_ns, pose);
  bad.mutable_pose()->mutable_position()->set_x(std::nan(""));
  ExpectRefused(bad, "finite");
}

TEST(DecodeFrame, BytesThatAreNoMessageAreRefused) {
  std::mt19937 random(3);
  for (const char* schema : {"foxglove.RawAudio", "foxglove.PointCloud", "foxglove.LaserScan",
                             "foxglove.Odometry", "foxglove.SceneUpdate"}) {
    for (int length = 1; length < 200; ++length) {
      std::string bytes(length, '\0');
      for (char& byte : bytes) byte = static_cast<char>(random());
      const auto frame = DecodeFrame(schema, bytes, TwoMicrophones());
      EXPECT_TRUE(frame.ok() || absl::IsInvalidArgument(frame.status())) << frame.status();
    }
  }
}

}  // namespace
}  // namespace soundmap::api
