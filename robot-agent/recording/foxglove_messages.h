#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "foxglove/FrameTransforms.pb.h"
#include "foxglove/LaserScan.pb.h"
#include "foxglove/Odometry.pb.h"
#include "foxglove/PointCloud.pb.h"
#include "foxglove/PoseInFrame.pb.h"
#include "foxglove/RawAudio.pb.h"
#include "recording/writer.h"

// The messages of a recording, made from plain numbers. Times in nanoseconds since the Unix epoch.
namespace soundmap::recording {

// Topics of the recording format.
inline constexpr std::string_view kTransformsTopic = "/tf_static";
inline constexpr std::string_view kAudioTopic = "/audio";
inline constexpr std::string_view kLidarTopic = "/lidar/points";
inline constexpr std::string_view kLaserTopic = "/scan";
inline constexpr std::string_view kOdometryTopic = "/odom";
inline constexpr std::string_view kGroundTruthTopic = "/ground_truth/pose";

google::protobuf::Timestamp TimestampFromNs(std::int64_t time_ns);
// None outside 1970 .. 2262.
std::optional<std::int64_t> NsFromTimestamp(const google::protobuf::Timestamp& timestamp);

// `samples` interleaved: sample s of channel c at s * channels + c.
foxglove::RawAudio MakeRawAudio(std::int64_t stamp_ns, int sample_rate_hz, int channels,
                                std::span<const std::int16_t> samples);
// Fields x, y, z and, unless it is empty, `time_offset_ns` (after the stamp, one a point); frame
// `lidar`.
foxglove::PointCloud MakePointCloud(std::int64_t stamp_ns,
                                    std::span<const Eigen::Vector3f> point_in_lidar,
                                    std::span<const std::uint32_t> time_offset_ns = {});
// Frame `laser`; stamp and angle of the first beam, angle of the last.
foxglove::LaserScan MakeLaserScan(std::int64_t stamp_ns, double start_angle_rad,
                                  double end_angle_rad, std::span<const double> range_m);
foxglove::Odometry MakeOdometry(std::int64_t stamp_ns, const Eigen::Isometry3d& odom_from_base);
foxglove::PoseInFrame MakePoseInFrame(std::int64_t stamp_ns, std::string_view frame,
                                      const Eigen::Isometry3d& frame_from_body);
foxglove::FrameTransform MakeFrameTransform(std::int64_t stamp_ns, std::string_view parent,
                                            std::string_view child,
                                            const Eigen::Isometry3d& parent_from_child);

// Writes a message under its own schema.
absl::Status WriteMessage(Writer& writer, std::string_view topic, std::int64_t log_time_ns,
                          std::uint32_t sequence, const google::protobuf::Message& message);

}  // namespace soundmap::recording
