#include "recording/foxglove_messages.h"

#include <bit>
#include <boost/endian/conversion.hpp>
#include <cassert>
#include <limits>

#include "recording/wire.h"

namespace soundmap::recording {
namespace {

constexpr std::int64_t kNsPerSecond = 1'000'000'000;

void SetVector(const Eigen::Vector3d& vector, foxglove::Vector3& out) {
  out.set_x(vector.x());
  out.set_y(vector.y());
  out.set_z(vector.z());
}

void SetQuaternion(const Eigen::Matrix3d& rotation, foxglove::Quaternion& out) {
  const Eigen::Quaterniond quaternion(rotation);
  out.set_x(quaternion.x());
  out.set_y(quaternion.y());
  out.set_z(quaternion.z());
  out.set_w(quaternion.w());
}

void SetPose(const Eigen::Isometry3d& pose, foxglove::Pose& out) {
  SetVector(pose.translation(), *out.mutable_position());
  SetQuaternion(pose.linear(), *out.mutable_orientation());
}

void AddField(std::string_view name, std::uint32_t offset,
              foxglove::PackedElementField::NumericType type, foxglove::PointCloud& cloud) {
  foxglove::PackedElementField& field = *cloud.add_fields();
  field.set_name(std::string(name));
  field.set_offset(offset);
  field.set_type(type);
}

}  // namespace

google::protobuf::Timestamp TimestampFromNs(std::int64_t time_ns) {
  google::protobuf::Timestamp timestamp;
  timestamp.set_seconds(time_ns / kNsPerSecond);
  timestamp.set_nanos(static_cast<std::int32_t>(time_ns % kNsPerSecond));
  return timestamp;
}

std::optional<std::int64_t> NsFromTimestamp(const google::protobuf::Timestamp& timestamp) {
  constexpr std::int64_t kMaxSeconds = std::numeric_limits<std::int64_t>::max() / kNsPerSecond - 1;
  if (timestamp.seconds() < 0 || timestamp.seconds() > kMaxSeconds || timestamp.nanos() < 0 ||
      timestamp.nanos() >= kNsPerSecond) {
    return std::nullopt;
  }
  return timestamp.seconds() * kNsPerSecond + timestamp.nanos();
}

foxglove::RawAudio MakeRawAudio(std::int64_t stamp_ns, int sample_rate_hz, int channels,
                                std::span<const std::int16_t> samples) {
  foxglove::RawAudio audio;
  *audio.mutable_timestamp() = TimestampFromNs(stamp_ns);
  audio.set_format("pcm-s16");
  audio.set_sample_rate(static_cast<std::uint32_t>(sample_rate_hz));
  audio.set_number_of_channels(static_cast<std::uint32_t>(channels));
  std::string& data = *audio.mutable_data();
  data.reserve(samples.size() * sizeof(std::int16_t));
  for (const std::int16_t sample : samples) AppendU16(data, static_cast<std::uint16_t>(sample));
  return audio;
}

foxglove::PointCloud MakePointCloud(std::int64_t stamp_ns,
                                    std::span<const Eigen::Vector3f> point_in_lidar,
                                    std::span<const std::uint32_t> time_offset_ns) {
  assert(time_offset_ns.empty() || time_offset_ns.size() == point_in_lidar.size());
  foxglove::PointCloud cloud;
  *cloud.mutable_timestamp() = TimestampFromNs(stamp_ns);
  cloud.set_frame_id("lidar");
  SetPose(Eigen::Isometry3d::Identity(), *cloud.mutable_pose());
  AddField("x", 0, foxglove::PackedElementField::FLOAT32, cloud);
  AddField("y", 4, foxglove::PackedElementField::FLOAT32, cloud);
  AddField("z", 8, foxglove::PackedElementField::FLOAT32, cloud);
  cloud.set_point_stride(12);
  if (!time_offset_ns.empty()) {
    AddField("time_offset_ns", 12, foxglove::PackedElementField::UINT32, cloud);
    cloud.set_point_stride(16);
  }
  std::string& data = *cloud.mutable_data();
  data.reserve(point_in_lidar.size() * cloud.point_stride());
  for (std::size_t i = 0; i < point_in_lidar.size(); ++i) {
    for (const float coordinate : point_in_lidar[i]) {
      AppendU32(data, std::bit_cast<std::uint32_t>(coordinate));
    }
    if (!time_offset_ns.empty()) AppendU32(data, time_offset_ns[i]);
  }
  return cloud;
}

foxglove::LaserScan MakeLaserScan(std::int64_t stamp_ns, double start_angle_rad,
                                  double end_angle_rad, std::span<const double> range_m) {
  foxglove::LaserScan scan;
  *scan.mutable_timestamp() = TimestampFromNs(stamp_ns);
  scan.set_frame_id("laser");
  SetPose(Eigen::Isometry3d::Identity(), *scan.mutable_pose());
  scan.set_start_angle(start_angle_rad);
  scan.set_end_angle(end_angle_rad);
  scan.mutable_ranges()->Add(range_m.begin(), range_m.end());
  return scan;
}

foxglove::Odometry MakeOdometry(std::int64_t stamp_ns, const Eigen::Isometry3d& odom_from_base) {
  foxglove::Odometry odometry;
  *odometry.mutable_timestamp() = TimestampFromNs(stamp_ns);
  odometry.set_frame_id("odom");
  odometry.set_body_frame_id("base_link");
  SetPose(odom_from_base, *odometry.mutable_pose());
  return odometry;
}

foxglove::PoseInFrame MakePoseInFrame(std::int64_t stamp_ns, std::string_view frame,
                                      const Eigen::Isometry3d& frame_from_body) {
  foxglove::PoseInFrame pose;
  *pose.mutable_timestamp() = TimestampFromNs(stamp_ns);
  pose.set_frame_id(std::string(frame));
  SetPose(frame_from_body, *pose.mutable_pose());
  return pose;
}

foxglove::FrameTransform MakeFrameTransform(std::int64_t stamp_ns, std::string_view parent,
                                            std::string_view child,
                                            const Eigen::Isometry3d& parent_from_child) {
  foxglove::FrameTransform transform;
  *transform.mutable_timestamp() = TimestampFromNs(stamp_ns);
  transform.set_parent_frame_id(std::string(parent));
  transform.set_child_frame_id(std::string(child));
  SetVector(parent_from_child.translation(), *transform.mutable_translation());
  SetQuaternion(parent_from_child.linear(), *transform.mutable_rotation());
  return transform;
}

absl::Status WriteMessage(Writer& writer, std::string_view topic, std::int64_t log_time_ns,
                          std::uint32_t sequence, const google::protobuf::Message& message) {
  std::string data;
  if (!message.SerializeToString(&data)) {
    return absl::InvalidArgumentError("a message is too large to be written");
  }
  return writer.Write(topic, message.GetDescriptor()->full_name(), log_time_ns, sequence, data);
}

}  // namespace soundmap::recording
