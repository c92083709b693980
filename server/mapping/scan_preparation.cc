#include "mapping/scan_preparation.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "mapping/laser_points.h"

namespace soundmap::mapping {
namespace {

using frames::TimeNs;
using geometry::Pose2;

// Scans that wait for the odometry of their end; more than this and the odometry is taken to have
// ended.
constexpr std::size_t kMaxWaitingScans = 32;

// Scans of the LRF among which those of the LIDAR that wait find the one of their time.
constexpr std::size_t kMaxLaserScans = 256;
constexpr std::size_t kMaxBeams = 20'000;
constexpr TimeNs kMaxApart_ns = 100'000'000;
// An LRF that is tilted more sees more than one height.
constexpr double kMaxTilt_rad = 0.02;
// Of a beam of the LRF its last part is not taken as free: so much, and what the beam is off where
// the scan's stamp is this much later than the odometry's of the same moment.
constexpr double kLaserMargin_m = 0.1;
constexpr double kMaxLag_s = 0.1;
// Nor what lies beyond the readings of so many beams on either side: LRFs give readings now and
// then that are too far.
constexpr std::size_t kBesides = 2;

}  // namespace

absl::Status ScanPreparation::Add(const frames::Odometry& odometry) {
  if (!IsStamp(odometry.stamp_ns)) {
    return absl::InvalidArgumentError("an odometry frame's stamp is out of range");
  }
  const std::optional<frames::Odometry> before =
      track_.empty() ? std::nullopt : std::optional(track_.entries().back());
  if (!track_.Add(odometry)) return absl::OkStatus();
  if (before && !config_.limits.Allow(before->odom_from_base.Inverse() * odometry.odom_from_base,
                                      odometry.stamp_ns - before->stamp_ns)) {
    jump_begin_ns_ = before->stamp_ns;
    jump_end_ns_ = odometry.stamp_ns;
  }
  if (!first_) first_ = odometry.odom_from_base;
  return absl::OkStatus();
}

absl::Status ScanPreparation::Add(const frames::LidarScan& scan) {
  ++scans_;
  if (!IsStamp(scan.stamp_ns)) {
    ++dropped_;
    return absl::InvalidArgumentError("a LIDAR scan's stamp is out of range");
  }
  if (!scan.time_offset_ns.empty() && scan.time_offset_ns.size() != scan.point_in_lidar.size()) {
    ++dropped_;
    return absl::InvalidArgumentError("a LIDAR scan has not one time offset a point");
  }
  Waiting waiting;
  waiting.scan.stamp_ns = scan.stamp_ns;
  waiting.end_ns = scan.stamp_ns;
  const auto min_squared_m2 = static_cast<float>(config_.min_range_m * config_.min_range_m);
  const auto max_squared_m2 = static_cast<float>(config_.max_range_m * config_.max_range_m);
  for (std::size_t i = 0; i < scan.point_in_lidar.size(); ++i) {
    const float squared_m2 = scan.point_in_lidar[i].squaredNorm();
    // Written so that NaN fails.
    if (!(squared_m2 > 0.0f && squared_m2 >= min_squared_m2 && squared_m2 <= max_squared_m2)) {
      continue;
    }
    waiting.scan.point_in_lidar.push_back(scan.point_in_lidar[i]);
    if (scan.time_offset_ns.empty()) continue;
    waiting.scan.time_offset_ns.push_back(scan.time_offset_ns[i]);
    waiting.end_ns = std::max(waiting.end_ns, scan.stamp_ns + TimeNs{scan.time_offset_ns[i]});
  }
  if (waiting.scan.point_in_lidar.empty()) {
    ++dropped_;
    ++without_points_;
    return absl::OkStatus();
  }
  waiting_.push_back(std::move(waiting));
  return absl::OkStatus();
}

absl::Status ScanPreparation::Add(const frames::LaserScan& scan) {
  if (!IsStamp(scan.stamp_ns) || !std::isfinite(scan.start_angle_rad) ||
      !std::isfinite(scan.angle_increment_rad) || scan.range_m.size() > kMaxBeams) {
    return absl::InvalidArgumentError("an LRF scan's stamp, angles or beams are out of range");
  }
  laser_scans_.push_back(scan);
  if (laser_scans_.size() > kMaxLaserScans) laser_scans_.pop_front();
  return absl::OkStatus();
}

std::optional<PreparedScan> ScanPreparation::Next(bool end) {
  while (!waiting_.empty()) {
    const bool covered = !track_.empty() && track_.newest_ns() >= waiting_.front().end_ns;
    if (!covered && !end && waiting_.size() <= kMaxWaitingScans) return std::nullopt;
    std::optional<PreparedScan> prepared = Prepare(waiting_.front());
    waiting_.pop_front();
    if (prepared) return prepared;
  }
  return std::nullopt;
}

std::optional<PreparedScan> ScanPreparation::Prepare(const Waiting& waiting) {
  const frames::LidarScan& scan = waiting.scan;
  const TimeNs duration_ns = waiting.end_ns - scan.stamp_ns;
  PreparedScan prepared;
  prepared.stamp_ns = scan.stamp_ns + duration_ns / 2;
  const auto odom_from_base = track_.Near(prepared.stamp_ns, kHoldOdometry_s);
  auto points =
      frames::PointsInBaseAt(scan, calibration_.base_from_lidar, track_, prepared.stamp_ns);
  if (!odom_from_base || !points) {
    ++dropped_;
    ++without_odometry_;
    return std::nullopt;
  }
  // A sweep in which the odometry jumped is bent beyond use.
  const bool bent = scan.stamp_ns < jump_end_ns_ && waiting.end_ns > jump_begin_ns_;
  if (bent || (last_ns_ && prepared.stamp_ns <= *last_ns_)) {
    ++dropped_;
    return std::nullopt;
  }
  last_ns_ = prepared.stamp_ns;
  prepared.odom_from_base = *odom_from_base;
  prepared.point_in_base = *std::move(points);
  prepared.part.reserve(prepared.point_in_base.size());
  for (std::size_t i = 0; i < prepared.point_in_base.size(); ++i) {
    const TimeNs offset_ns = scan.time_offset_ns.empty() ? 0 : TimeNs{scan.time_offset_ns[i]};
    prepared.part.push_back(static_cast<std::uint8_t>(offset_ns * kSweepParts / (duration_ns + 1)));
  }
  for (int part = 0; part < kSweepParts; ++part) {
    const TimeNs middle_ns = scan.stamp_ns + duration_ns * (2 * part + 1) / (2 * kSweepParts);
    const Pose2 odom_from_part = track_.Near(middle_ns, kHoldOdometry_s).value_or(*odom_from_base);
    const Pose2 base_from_part = odom_from_base->Inverse() * odom_from_part;
    prepared.lidar_in_base[part] =
        (base_from_part.ToIsometry() * calibration_.base_from_lidar).translation().cast<float>();
  }
  prepared.seen_through = SeenThroughAt(prepared.stamp_ns);
  return prepared;
}

SeenThrough ScanPreparation::SeenThroughAt(TimeNs time_ns) const {
  const frames::LaserScan* nearest = nullptr;
  TimeNs apart_ns = kMaxApart_ns;
  for (const frames::LaserScan& scan : laser_scans_) {
    const TimeNs distance_ns = std::abs(scan.stamp_ns - time_ns);
    if (distance_ns > apart_ns) continue;
    nearest = &scan;
    apart_ns = distance_ns;
  }
  const Eigen::Isometry3d& mount = calibration_.base_from_laser;
  const bool is_level = mount.linear().col(2).head<2>().norm() <= kMaxTilt_rad;
  const auto then = track_.Near(time_ns - frames::NsFromSeconds(kMaxLag_s), kHoldOdometry_s);
  const auto now = track_.Near(time_ns, kHoldOdometry_s);
  if (!nearest || !is_level || mount.translation().z() < kMinLaserHeight_m || !then || !now) {
    return {};
  }
  const auto points = PointsOf(*nearest, calibration_, 0.0, config_.max_range_m, track_,
                               /*lag_ns=*/0, time_ns);
  if (!points) return {};
  const Pose2 moved = then->Inverse() * *now;
  const double margin_m = kLaserMargin_m + std::hypot(moved.x_m, moved.y_m);

  SeenThrough seen;
  const auto height_m = static_cast<float>(mount.translation().z());
  const Eigen::Vector2f laser = 0.5f * (points->laser_begin_in_base + points->laser_end_in_base);
  seen.laser_in_base = {laser.x(), laser.y(), height_m};
  for (std::size_t i = kBesides; i + kBesides < points->point_in_base.size(); ++i) {
    const std::size_t first = i - kBesides, last = i + kBesides;
    if (points->beam[last] - points->beam[first] != 2 * kBesides) continue;
    double range_m = config_.max_range_m;
    for (std::size_t j = first; j <= last; ++j) {
      range_m = std::min<double>(range_m, (points->point_in_base[j] - laser).norm());
    }
    const double free_m = range_m * (1.0 - std::abs(moved.yaw_rad)) - margin_m;
    if (!(free_m > 0.0)) continue;
    const Eigen::Vector2f direction = (points->point_in_base[i] - laser).normalized();
    const Eigen::Vector2f to = laser + static_cast<float>(free_m) * direction;
    seen.to_in_base.emplace_back(to.x(), to.y(), height_m);
  }
  return seen;
}

}  // namespace soundmap::mapping
