#pragma once

#include <deque>
#include <optional>

#include "frames/frames.h"

namespace soundmap::frames {

// The recent odometry of one robot, to be asked for the pose at any time in it. Time runs forwards:
// an entry that is not newer than the last one is refused. Bounded: entries older than `keep_s`
// before the newest are forgotten.
class OdometryTrack {
 public:
  explicit OdometryTrack(double keep_s = 30.0) : keep_ns_(NsFromSeconds(keep_s)) {}

  // False, and no change, when the stamp is not after the newest or a number is not finite.
  bool Add(const Odometry& odometry);

  // odom_from_base, interpolated; none outside the track.
  std::optional<geometry::Pose2> At(TimeNs time_ns) const;

  // As At(), but up to `limit_s` beyond either end the nearest entry holds.
  std::optional<geometry::Pose2> Near(TimeNs time_ns, double limit_s) const;

  bool empty() const { return entries_.empty(); }
  TimeNs oldest_ns() const { return entries_.front().stamp_ns; }
  TimeNs newest_ns() const { return entries_.back().stamp_ns; }
  const std::deque<Odometry>& entries() const { return entries_; }

 private:
  TimeNs keep_ns_;
  std::deque<Odometry> entries_;
};

// The points of a scan as if all had been taken at `reference_ns`, in base_link at that time: each
// is moved by the odometry between its own time and the reference. None if the track does not cover
// the scan within 0.2 s.
std::optional<std::vector<Eigen::Vector3f>> PointsInBaseAt(const LidarScan& scan,
                                                           const Eigen::Isometry3d& base_from_lidar,
                                                           const OdometryTrack& track,
                                                           TimeNs reference_ns);

}  // namespace soundmap::frames
