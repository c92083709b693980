#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "frames/frames.h"
#include "frames/odometry_track.h"
#include "geometry/pose.h"
#include "mapping/drive_limits.h"
#include "mapping/key_scan_graph.h"

namespace soundmap::mapping {

struct ScanPreparationConfig {
  double min_range_m = 0.4;
  double max_range_m = 40.0;
  MotionLimits limits;
};

// A LIDAR sweep with its points in range, straightened: all are as if taken in its middle.
struct PreparedScan {
  frames::TimeNs stamp_ns = 0;  // of its middle
  geometry::Pose2 odom_from_base;
  std::vector<Eigen::Vector3f> point_in_base;
  std::vector<std::uint8_t> part;  // of the sweep, for each point
  std::array<Eigen::Vector3f, kSweepParts> lidar_in_base;
  SeenThrough seen_through;
};

// One drive's LIDAR, LRF and odometry, brought together in time. Scans wait until the odometry has
// covered them. Bounded.
class ScanPreparation {
 public:
  ScanPreparation(const ScanPreparationConfig& config, const frames::Calibration& calibration)
      : config_(config), calibration_(calibration) {}

  // InvalidArgument: a malformed frame; it is left out.
  absl::Status Add(const frames::Odometry& odometry);
  absl::Status Add(const frames::LidarScan& scan);
  absl::Status Add(const frames::LaserScan& scan);

  // The next scan in order of time; none until the odometry has come. At the `end` of a drive those
  // that wait still come as far as the odometry reaches.
  std::optional<PreparedScan> Next(bool end);

  const MotionLimits& limits() const { return config_.limits; }
  const frames::OdometryTrack& track() const { return track_; }
  const std::optional<geometry::Pose2>& first_odom_from_base() const { return first_; }
  int scans() const { return scans_; }
  int dropped() const { return dropped_; }
  int without_points() const { return without_points_; }
  int without_odometry() const { return without_odometry_; }

 private:
  struct Waiting {
    frames::LidarScan scan;  // points in range only
    frames::TimeNs end_ns = 0;
  };

  std::optional<PreparedScan> Prepare(const Waiting& waiting);
  SeenThrough SeenThroughAt(frames::TimeNs time_ns) const;

  ScanPreparationConfig config_;
  frames::Calibration calibration_;
  frames::OdometryTrack track_;
  std::optional<geometry::Pose2> first_;
  // The last step of the odometry that no robot can take.
  frames::TimeNs jump_begin_ns_ = 0;
  frames::TimeNs jump_end_ns_ = 0;
  std::deque<Waiting> waiting_;
  std::deque<frames::LaserScan> laser_scans_;  // the newest
  std::optional<frames::TimeNs> last_ns_;
  int scans_ = 0;
  int dropped_ = 0;  // includes the following two
  int without_points_ = 0;
  int without_odometry_ = 0;
};

}  // namespace soundmap::mapping
