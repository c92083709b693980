#include "frames/odometry_track.h"

#include <algorithm>
#include <cmath>

namespace soundmap::frames {
namespace {

// How far beyond its ends the odometry may be held constant for a LIDAR point.
constexpr double kHoldLimit_s = 0.2;

// Points of one sweep share a transform within this time; a robot turning at 1 rad/s moves by 0.06
// degrees meanwhile.
constexpr TimeNs kSameTime_ns = 1'000'000;

bool IsFinite(const geometry::Pose2& pose) {
  return std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.yaw_rad);
}

}  // namespace

bool OdometryTrack::Add(const Odometry& odometry) {
  if (!IsFinite(odometry.odom_from_base)) return false;
  if (!entries_.empty() && odometry.stamp_ns <= entries_.back().stamp_ns) return false;
  entries_.push_back(odometry);
  while (entries_.size() > 2 && entries_[1].stamp_ns < odometry.stamp_ns - keep_ns_) {
    entries_.pop_front();
  }
  return true;
}

std::optional<geometry::Pose2> OdometryTrack::At(TimeNs time_ns) const {
  if (entries_.empty() || time_ns < oldest_ns() || time_ns > newest_ns()) return std::nullopt;
  const auto after = std::lower_bound(
      entries_.begin(), entries_.end(), time_ns,
      [](const Odometry& entry, TimeNs wanted_ns) { return entry.stamp_ns < wanted_ns; });
  if (after->stamp_ns == time_ns) return after->odom_from_base;
  const auto before = std::prev(after);
  const double fraction = static_cast<double>(time_ns - before->stamp_ns) /
                          static_cast<double>(after->stamp_ns - before->stamp_ns);
  return geometry::Interpolate(before->odom_from_base, after->odom_from_base, fraction);
}

std::optional<geometry::Pose2> OdometryTrack::Near(TimeNs time_ns, double limit_s) const {
  if (entries_.empty()) return std::nullopt;
  const TimeNs inside_ns = std::clamp(time_ns, oldest_ns(), newest_ns());
  if (std::abs(SecondsFromNs(time_ns - inside_ns)) > limit_s) return std::nullopt;
  return At(inside_ns);
}

std::optional<std::vector<Eigen::Vector3f>> PointsInBaseAt(const LidarScan& scan,
                                                           const Eigen::Isometry3d& base_from_lidar,
                                                           const OdometryTrack& track,
                                                           TimeNs reference_ns) {
  const auto odom_from_reference = track.Near(reference_ns, kHoldLimit_s);
  if (!odom_from_reference) return std::nullopt;
  const geometry::Pose2 reference_from_odom = odom_from_reference->Inverse();

  std::vector<Eigen::Vector3f> point_in_base(scan.point_in_lidar.size());
  Eigen::Isometry3f reference_from_lidar = Eigen::Isometry3f::Identity();
  std::optional<TimeNs> transform_time_ns;
  for (std::size_t i = 0; i < scan.point_in_lidar.size(); ++i) {
    const TimeNs time_ns =
        scan.stamp_ns + (scan.time_offset_ns.empty() ? 0 : TimeNs{scan.time_offset_ns[i]});
    if (!transform_time_ns || std::abs(time_ns - *transform_time_ns) > kSameTime_ns) {
      const auto odom_from_base = track.Near(time_ns, kHoldLimit_s);
      if (!odom_from_base) return std::nullopt;
      reference_from_lidar =
          ((reference_from_odom * *odom_from_base).ToIsometry() * base_from_lidar).cast<float>();
      transform_time_ns = time_ns;
    }
    point_in_base[i] = reference_from_lidar * scan.point_in_lidar[i];
  }
  return point_in_base;
}

}  // namespace soundmap::frames
