#include "mapping/scan_preparation.h"

#include <algorithm>
#include <cmath>

namespace soundmap::mapping {
namespace {

using frames::TimeNs;
using geometry::Pose2;

// Scans that wait for the odometry of their end; more than this and the odometry is taken to have
// ended.
constexpr std::size_t kMaxWaitingScans = 32;

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
  return prepared;
}

}  // namespace soundmap::mapping
