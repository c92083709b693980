#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <span>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "geometry/pose.h"

namespace soundmap::frames {

// Capture time, nanoseconds since the Unix epoch, on the robot's clock.
using TimeNs = std::int64_t;

constexpr double SecondsFromNs(TimeNs duration_ns) {
  return static_cast<double>(duration_ns) * 1e-9;
}
constexpr TimeNs NsFromSeconds(double duration_s) { return static_cast<TimeNs>(duration_s * 1e9); }

// Some samples of every microphone.
struct AudioBlock {
  TimeNs stamp_ns = 0;  // of the first sample
  int sample_rate_hz = 0;
  int channels = 0;
  std::vector<std::int16_t> samples;  // interleaved: sample s of channel c at s * channels + c

  int samples_per_channel() const { return static_cast<int>(samples.size()) / channels; }
};

// One turn of the 3D LIDAR. A point that is not finite or lies at the origin is "no return" and is
// left out when the scan is made.
struct LidarScan {
  TimeNs stamp_ns = 0;
  std::vector<Eigen::Vector3f> point_in_lidar;
  std::vector<std::uint32_t> time_offset_ns;  // after the stamp, one a point; empty: instantaneous
};

// One sweep of the laser range finder (LRF) in its x-y plane.
struct LaserScan {
  TimeNs stamp_ns = 0;  // of the first beam
  double start_angle_rad = 0.0;
  double angle_increment_rad = 0.0;
  std::vector<float> range_m;  // NaN: no return
};

struct Odometry {
  TimeNs stamp_ns = 0;
  geometry::Pose2 odom_from_base;
};

// What a robot sends, in the order in which it was captured or arrived.
using Frame = std::variant<AudioBlock, LidarScan, LaserScan, Odometry>;

TimeNs StampOf(const Frame& frame);

// The robot's sensors and where they are mounted.
struct Calibration {
  Eigen::Isometry3d base_from_array = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d base_from_lidar = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d base_from_laser = Eigen::Isometry3d::Identity();
  std::vector<Eigen::Vector3d>
      mic_in_array_m;                   // in channel order; empty: the robot has no microphones
  double laser_time_increment_s = 0.0;  // 0: a laser scan is instantaneous
  int audio_sample_rate_hz = 0;         // 0: no audio
  // Sound pressure level (re 20 uPa) of the sine that just reaches full scale at the microphones;
  // none: not known.
  std::optional<double> full_scale_spl_db;

  // InvalidArgument: a number that is not finite, 1 or more than 64 microphones, two at one place,
  // a sample rate outside 8 .. 192 kHz where there are microphones, a full scale outside 60 .. 200
  // dB.
  absl::Status Validate() const;
};

}  // namespace soundmap::frames
