#include "api/decode_frame.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "absl/strings/str_cat.h"
#include "foxglove/LaserScan.pb.h"
#include "foxglove/Odometry.pb.h"
#include "foxglove/PointCloud.pb.h"
#include "foxglove/RawAudio.pb.h"

namespace soundmap::api {
namespace {

constexpr std::size_t kMaxBeams = 1 << 20;
constexpr std::size_t kMaxPoints = 1 << 22;
// A LIDAR return nearer than this to its own origin is no return.
constexpr float kMinLidarRange_m = 1e-3f;

template <typename Message>
absl::StatusOr<Message> Parse(std::string_view schema, std::string_view payload) {
  Message message;
  if (!message.ParseFromArray(payload.data(), static_cast<int>(payload.size()))) {
    return absl::InvalidArgumentError(
        absl::StrCat("the frame's payload is not a ", std::string(schema), " message"));
  }
  return message;
}

absl::StatusOr<frames::TimeNs> StampFrom(const google::protobuf::Timestamp& stamp) {
  constexpr std::int64_t kMaxSeconds = std::numeric_limits<std::int64_t>::max() / 1'000'000'000 - 1;
  if (stamp.seconds() < 0 || stamp.seconds() > kMaxSeconds || stamp.nanos() < 0 ||
      stamp.nanos() > 999'999'999) {
    return absl::InvalidArgumentError(
        absl::StrCat("the frame's time stamp of ", stamp.seconds(), " s is outside 1970 to 2262"));
  }
  return stamp.seconds() * 1'000'000'000 + stamp.nanos();
}

absl::StatusOr<Eigen::Isometry3d> TransformFrom(const foxglove::Pose& pose) {
  const auto& q = pose.orientation();
  const auto& p = pose.position();
  Eigen::Quaterniond rotation(q.w(), q.x(), q.y(), q.z());
  const Eigen::Vector3d translation(p.x(), p.y(), p.z());
  if (rotation.coeffs().isZero()) rotation.setIdentity();  // an absent message
  if (!rotation.coeffs().allFinite() || !translation.allFinite() ||
      std::abs(rotation.norm() - 1.0) > 1e-2) {
    return absl::InvalidArgumentError("the frame's pose is not a finite rigid transform");
  }
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  transform.linear() = rotation.normalized().toRotationMatrix();
  transform.translation() = translation;
  return transform;
}

absl::StatusOr<frames::Frame> DecodeAudio(std::string_view schema, std::string_view payload,
                                          const frames::Calibration& calibration) {
  const auto message = Parse<foxglove::RawAudio>(schema, payload);
  if (!message.ok()) return message.status();
  const auto stamp_ns = StampFrom(message->timestamp());
  if (!stamp_ns.ok()) return stamp_ns.status();
  if (message->format() != "pcm-s16") {
    return absl::InvalidArgumentError(absl::StrCat("audio in the format '", message->format(),
                                                   "' is not taken; lossless 'pcm-s16' is"));
  }
  const std::size_t channels = message->number_of_channels();
  if (channels != calibration.mic_in_array_m.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("the audio has ", channels, " channels, the calibration has ",
                     calibration.mic_in_array_m.size(), " microphones"));
  }
  if (static_cast<std::int64_t>(message->sample_rate()) != calibration.audio_sample_rate_hz) {
    return absl::InvalidArgumentError(
        absl::StrCat("the audio is sampled at ", message->sample_rate(),
                     " Hz, the calibration says ", calibration.audio_sample_rate_hz, " Hz"));
  }
  const std::string& data = message->data();
  if (data.empty() || data.size() % (2 * channels) != 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the audio's ", data.size(), " bytes are not whole samples of ", channels, " channels"));
  }
  frames::AudioBlock block;
  block.stamp_ns = *stamp_ns;
  block.sample_rate_hz = static_cast<int>(message->sample_rate());
  block.channels = static_cast<int>(channels);
  block.samples.resize(data.size() / 2);
  std::memcpy(block.samples.data(), data.data(), data.size());
  return block;
}

// One number of a packed point.
struct Field {
  std::uint32_t offset = 0;
  bool is_double = false;

  float Read(const char* element) const {
    if (is_double) {
      double value;
      std::memcpy(&value, element + offset, sizeof(value));
      return static_cast<float>(value);
    }
    float value;
    std::memcpy(&value, element + offset, sizeof(value));
    return value;
  }
};

absl::StatusOr<frames::Frame> DecodeLidar(std::string_view schema, std::string_view payload) {
  using foxglove::PackedElementField;
  const auto message = Parse<foxglove::PointCloud>(schema, payload);
  if (!message.ok()) return message.status();
  const auto stamp_ns = StampFrom(message->timestamp());
  if (!stamp_ns.ok()) return stamp_ns.status();
  const auto lidar_from_cloud = TransformFrom(message->pose());
  if (!lidar_from_cloud.ok()) return lidar_from_cloud.status();

  std::optional<Field> axes[3];
  std::optional<std::uint32_t> time_offset;
  const std::uint32_t stride = message->point_stride();
  for (const PackedElementField& field : message->fields()) {
    const std::string& name = field.name();
    const bool is_axis = name == "x" || name == "y" || name == "z";
    const bool is_time = name == "time_offset_ns";
    if (!is_axis && !is_time) continue;
    const bool is_double = field.type() == PackedElementField::FLOAT64;
    const bool type_fits = is_axis ? is_double || field.type() == PackedElementField::FLOAT32
                                   : field.type() == PackedElementField::UINT32;
    if (!type_fits) {
      return absl::InvalidArgumentError(
          absl::StrCat("the point cloud's field '", name, "' has the wrong type: x, y, z are ",
                       "float32 or float64, time_offset_ns is uint32"));
    }
    if (std::uint64_t{field.offset()} + (is_double ? 8 : 4) > stride) {
      return absl::InvalidArgumentError(absl::StrCat(
          "the point cloud's field '", name, "' ends beyond the stride of ", stride, " bytes"));
    }
    if (is_time) {
      time_offset = field.offset();
    } else {
      axes[name[0] - 'x'] = Field{field.offset(), is_double};
    }
  }
  if (!axes[0] || !axes[1] || !axes[2]) {
    return absl::InvalidArgumentError("the point cloud lacks a field x, y or z");
  }
  const std::string& data = message->data();
  if (data.size() % stride != 0 || data.size() / stride > kMaxPoints) {
    return absl::InvalidArgumentError(absl::StrCat("the point cloud's ", data.size(),
                                                   " bytes are not up to ", kMaxPoints,
                                                   " points of ", stride, " bytes"));
  }

  frames::LidarScan scan;
  scan.stamp_ns = *stamp_ns;
  scan.point_in_lidar.reserve(data.size() / stride);
  if (time_offset) scan.time_offset_ns.reserve(data.size() / stride);
  const Eigen::Isometry3f transform = lidar_from_cloud->cast<float>();
  for (const char* element = data.data(); element != data.data() + data.size(); element += stride) {
    const Eigen::Vector3f point(axes[0]->Read(element), axes[1]->Read(element),
                                axes[2]->Read(element));
    if (!point.allFinite() || point.squaredNorm() < kMinLidarRange_m * kMinLidarRange_m) continue;
    scan.point_in_lidar.push_back(transform * point);
    if (time_offset) {
      std::uint32_t offset_ns;
      std::memcpy(&offset_ns, element + *time_offset, sizeof(offset_ns));
      scan.time_offset_ns.push_back(offset_ns);
    }
  }
  return scan;
}

absl::StatusOr<frames::Frame> DecodeLaser(std::string_view schema, std::string_view payload) {
  const auto message = Parse<foxglove::LaserScan>(schema, payload);
  if (!message.ok()) return message.status();
  const auto stamp_ns = StampFrom(message->timestamp());
  if (!stamp_ns.ok()) return stamp_ns.status();
  const std::size_t beams = message->ranges_size();
  if (beams > kMaxBeams) {
    return absl::InvalidArgumentError(
        absl::StrCat("the laser scan has ", beams, " beams; ", kMaxBeams, " are the limit"));
  }
  if (!std::isfinite(message->start_angle()) || !std::isfinite(message->end_angle())) {
    return absl::InvalidArgumentError("the laser scan's start or end angle is not finite");
  }
  const auto laser_from_scan = TransformFrom(message->pose());
  if (!laser_from_scan.ok()) return laser_from_scan.status();
  if (!laser_from_scan->isApprox(Eigen::Isometry3d::Identity(), 1e-6)) {
    return absl::InvalidArgumentError(
        "the laser scan has a pose of its own in the frame laser; put it into /tf_static");
  }
  frames::LaserScan scan;
  scan.stamp_ns = *stamp_ns;
  scan.start_angle_rad = message->start_angle();
  scan.angle_increment_rad =
      beams > 1 ? (message->end_angle() - message->start_angle()) / static_cast<double>(beams - 1)
                : 0.0;
  scan.range_m.reserve(beams);
  for (const double range_m : message->ranges()) {
    scan.range_m.push_back(std::isfinite(range_m) && range_m > 0.0
                               ? static_cast<float>(range_m)
                               : std::numeric_limits<float>::quiet_NaN());
  }
  return scan;
}

absl::StatusOr<frames::Frame> DecodeOdometry(std::string_view schema, std::string_view payload) {
  const auto message = Parse<foxglove::Odometry>(schema, payload);
  if (!message.ok()) return message.status();
  const auto stamp_ns = StampFrom(message->timestamp());
  if (!stamp_ns.ok()) return stamp_ns.status();
  const auto odom_from_base = TransformFrom(message->pose());
  if (!odom_from_base.ok()) return odom_from_base.status();
  return frames::Odometry{*stamp_ns, geometry::ProjectToFloor(*odom_from_base)};
}

}  // namespace

absl::StatusOr<frames::Frame> DecodeFrame(std::string_view schema, std::string_view payload,
                                          const frames::Calibration& calibration) {
  if (schema == "foxglove.RawAudio") return DecodeAudio(schema, payload, calibration);
  if (schema == "foxglove.PointCloud") return DecodeLidar(schema, payload);
  if (schema == "foxglove.LaserScan") return DecodeLaser(schema, payload);
  if (schema == "foxglove.Odometry") return DecodeOdometry(schema, payload);
  return absl::InvalidArgumentError(
      absl::StrCat("a frame of the kind '", std::string(schema), "' is not known"));
}

}  // namespace soundmap::api
