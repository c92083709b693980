#include "mapping/laser_front_end.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "geometry/angles.h"
#include "mapping/laser_matching.h"
#include "mapping/planar_poses.h"

namespace soundmap::mapping {
namespace {

using frames::SecondsFromNs;
using frames::TimeNs;
using geometry::Pose2;

// Scans that wait for the odometry of their end; more than this and the odometry is taken to have
// ended.
constexpr std::size_t kMaxWaitingScans = 256;

// One point in each square of this size is enough to align a scan.
constexpr float kMatchedPoints_m = 0.05f;
// What is in view before and after a larger step may be too little to be sure of.
constexpr double kSmallStep_rad = 0.5;
constexpr double kSmallStep_s = 1.0;
constexpr double kLargeStepVariance = 0.25;

// A matched scan, however well it fits.
constexpr double kMatchStd_m = 0.003;
constexpr double kMatchStd_rad = 0.0005;
// A way by odometry alone counts as so many times as long for the search for loops.
constexpr double kUnregisteredWay = 5.0;
constexpr double kUnregisteredVariance = 10.0;

// Scans further apart do not tell when a turn began.
constexpr TimeNs kMaxLagStep_ns = 1'000'000'000;
constexpr double kMaxLagStd_s = 0.01;

}  // namespace

LaserFrontEnd::LaserFrontEnd(const FloorPlanMapperConfig& config,
                             const frames::Calibration& calibration, const Pose2& map_from_base)
    : config_(config),
      calibration_(calibration),
      start_map_from_base_(map_from_base),
      limits_{config.max_speed_mps, config.max_turn_rate_radps},
      lag_ns_(frames::NsFromSeconds(config.laser_lag_s.value_or(0.0))),
      local_map_(config.wall_piece_m, config.local_map_m),
      places_(config.key_scans_per_place) {}

void LaserFrontEnd::LocalMap::Insert(std::span<const Eigen::Vector2f> point_in_map, double way_m) {
  if (way_m - current_from_m_ >= length_m_ && next_.size() > 0) {
    current_ = std::exchange(next_, LineMap(piece_m_));
    current_from_m_ = std::exchange(next_from_m_, way_m);
  }
  if (way_m - current_from_m_ >= 0.5 * length_m_) {
    if (next_.size() == 0) next_from_m_ = way_m;
    next_.Insert(point_in_map);
    next_.FitLines();
  }
  current_.Insert(point_in_map);
  current_.FitLines();
}

absl::Status LaserFrontEnd::Add(const frames::Odometry& odometry) {
  if (!IsStamp(odometry.stamp_ns)) {
    return absl::InvalidArgumentError("an odometry frame's stamp is out of range");
  }
  if (!track_.Add(odometry)) return absl::OkStatus();
  if (!first_odom_from_base_) first_odom_from_base_ = odometry.odom_from_base;
  lag_.Follow(track_);
  ProcessWaiting(/*all=*/false);
  return absl::OkStatus();
}

absl::Status LaserFrontEnd::Add(const frames::LaserScan& scan) {
  ++report_.scans;
  if (!IsStamp(scan.stamp_ns)) {
    ++report_.scans_dropped;
    return absl::InvalidArgumentError("an LRF scan's stamp is out of range");
  }
  if (!std::isfinite(scan.start_angle_rad) || !std::isfinite(scan.angle_increment_rad)) {
    ++report_.scans_dropped;
    return absl::InvalidArgumentError("an LRF scan's angles are not finite");
  }
  if (scan.range_m.size() > 65536) {
    ++report_.scans_dropped;
    return absl::InvalidArgumentError("an LRF scan has more than 65536 beams");
  }
  const bool any = std::any_of(scan.range_m.begin(), scan.range_m.end(), [this](float range_m) {
    return range_m >= config_.min_range_m && range_m <= config_.max_range_m;
  });
  if (!any) {
    ++report_.scans_dropped;
    ++scans_without_points_;
    return absl::OkStatus();
  }
  const double sweep_s =
      calibration_.laser_time_increment_s * static_cast<double>(scan.range_m.size() - 1);
  waiting_.push_back({scan, scan.stamp_ns + frames::NsFromSeconds(sweep_s)});
  ProcessWaiting(/*all=*/false);
  return absl::OkStatus();
}

void LaserFrontEnd::ProcessWaiting(bool all) {
  while (!waiting_.empty()) {
    const bool covered = !track_.empty() && track_.newest_ns() >= waiting_.front().end_ns - lag_ns_;
    if (!covered && !all && waiting_.size() <= kMaxWaitingScans) return;
    Process(waiting_.front());
    waiting_.pop_front();
  }
}

void LaserFrontEnd::Process(const WaitingScan& waiting) {
  LaserPathEntry entry;
  entry.stamp_ns = waiting.scan.stamp_ns + (waiting.end_ns - waiting.scan.stamp_ns) / 2;
  const auto odom_from_base = track_.Near(entry.stamp_ns - lag_ns_, kHoldOdometry_s);
  auto points = PointsOf(waiting.scan, calibration_, config_.min_range_m, config_.max_range_m,
                         track_, lag_ns_, entry.stamp_ns);
  if (!odom_from_base || !points) {
    ++report_.scans_dropped;
    ++scans_without_odometry_;
    return;
  }
  if (!path_.empty() && entry.stamp_ns <= path_.back().stamp_ns) {
    ++report_.scans_dropped;
    return;
  }
  entry.odom_from_base = *odom_from_base;
  std::vector<Eigen::Vector2f> to_match =
      FirstPointPerSquare(points->point_in_base, kMatchedPoints_m);
  bool odometry_is_sound = true;
  entry.map_from_base = Predict(entry.stamp_ns, *odom_from_base, odometry_is_sound);
  bool placed = true;
  if (!path_.empty()) {
    entry.key_scan = path_.back().key_scan;
    const double step_m = Distance(path_.back().map_from_base, entry.map_from_base);
    const double prior_std_m = StepStd_m(step_m);
    const double prior_std_rad = StepStd_rad(
        geometry::NormalizeAngle(entry.map_from_base.yaw_rad - path_.back().map_from_base.yaw_rad));
    Eigen::Vector3d prior_weight(prior_std_m, prior_std_m, prior_std_rad);
    prior_weight = prior_weight.cwiseProduct(prior_weight).cwiseInverse().eval();
    const LaserMatch match =
        AlignToPath(to_match, local_map_.lines(), path_, unregistered_in_a_row_,
                    entry.map_from_base, *odom_from_base, entry.stamp_ns, odometry_is_sound);
    Eigen::Matrix3d information = prior_weight.asDiagonal();
    if (match.inliers >= kMinMatchInliers && match.fit() >= kMinMatchFit) {
      entry.map_from_base = match.map_from_base;
      information += match.information;
      unregistered_in_a_row_ = 0;
      match_covariance_ = information.inverse();
      // What is in view before and after a large turn may be too little to be sure of.
      const Pose2 step = path_.back().map_from_base.Inverse() * match.map_from_base;
      if (std::abs(step.yaw_rad) > kSmallStep_rad ||
          entry.stamp_ns - path_.back().stamp_ns > frames::NsFromSeconds(kSmallStep_s)) {
        unregistered_covariance_ +=
            kLargeStepVariance * prior_weight.cwiseInverse().asDiagonal().toDenseMatrix();
      }
      way_m_ += Distance(path_.back().map_from_base, entry.map_from_base);
    } else {
      ++report_.scans_unregistered;
      // By odometry where nothing speaks against it: a new part of the building, or one without
      // walls.
      placed = odometry_is_sound && match.constraints < kMinMatchInliers;
      ++unregistered_in_a_row_;
      unregistered_covariance_ += kUnregisteredVariance * information.inverse();
      way_m_ += kUnregisteredWay * Distance(path_.back().map_from_base, entry.map_from_base);
    }
  }
  if (placed && HasMoved(entry.map_from_base)) {
    inserted_at_ = entry.map_from_base;
    std::vector<Eigen::Vector2f> in_map;
    const Eigen::Isometry2f map_from_base = InPlane(entry.map_from_base);
    for (const Eigen::Vector2f& point : points->point_in_base) {
      in_map.push_back(map_from_base * point);
    }
    local_map_.Insert(in_map, way_m_);
    if (places_.Take(entry.map_from_base)) {
      entry.key_scan = key_scans_.size();
      Keep(entry, *std::move(points), std::move(to_match));
    }
  }
  if (!config_.laser_lag_s) {
    const bool follows = !path_.empty() && unregistered_in_a_row_ == 0 &&
                         entry.stamp_ns - path_.back().stamp_ns <= kMaxLagStep_ns;
    if (!follows) lag_.Break();
    lag_.Add(entry.stamp_ns, entry.map_from_base.yaw_rad);
    if (const auto lag_s = lag_.lag_s(kMaxLagStd_s)) lag_ns_ = frames::NsFromSeconds(*lag_s);
  }
  path_.push_back(entry);
}

void LaserFrontEnd::Keep(const LaserPathEntry& entry, LaserPoints points,
                         std::vector<Eigen::Vector2f> to_match) {
  LaserKeyScan key_scan;
  key_scan.path_index = path_.size();
  key_scan.points = std::move(points);
  key_scan.point_to_match = std::move(to_match);
  key_scan.map_from_base = entry.map_from_base;
  key_scan.way_m = way_m_;
  // Scans share the error of the local map that they are aligned to, so it grows only as that moves
  // on.
  const double step_m = key_scans_.empty() ? 0.0 : way_m_ - key_scans_.back().way_m;
  key_scan.step_covariance =
      match_covariance_ * std::min(1.0, step_m / (0.5 * config_.local_map_m)) +
      std::exchange(unregistered_covariance_, Eigen::Matrix3d::Zero());
  key_scan.step_covariance.diagonal() += Eigen::Vector3d(
      kMatchStd_m * kMatchStd_m, kMatchStd_m * kMatchStd_m, kMatchStd_rad * kMatchStd_rad);
  key_scans_.push_back(std::move(key_scan));
}

Pose2 LaserFrontEnd::Predict(TimeNs stamp_ns, const Pose2& odom_from_base,
                             bool& odometry_is_sound) const {
  if (path_.empty()) {
    return start_map_from_base_ * first_odom_from_base_->Inverse() * odom_from_base;
  }
  const LaserPathEntry& last = path_.back();
  const Pose2 last_from_base = last.odom_from_base.Inverse() * odom_from_base;
  odometry_is_sound = limits_.Allow(last_from_base, stamp_ns - last.stamp_ns);
  return odometry_is_sound ? last.map_from_base * last_from_base : last.map_from_base;
}

bool LaserFrontEnd::HasMoved(const Pose2& map_from_base) const {
  if (!inserted_at_) return true;
  const Pose2 step = inserted_at_->Inverse() * map_from_base;
  return std::hypot(step.x_m, step.y_m) >= config_.key_scan_distance_m ||
         std::abs(step.yaw_rad) >= config_.key_scan_angle_rad;
}

absl::Status LaserFrontEnd::NothingToMap() const {
  if (report_.scans == 0) return absl::InvalidArgumentError("the mapping drive has no LRF scans");
  if (!first_odom_from_base_) {
    return absl::InvalidArgumentError("the mapping drive has no odometry");
  }
  if (scans_without_points_ == report_.scans) {
    return absl::InvalidArgumentError(
        absl::StrCat("none of the mapping drive's ", report_.scans, " LRF scans has a return from ",
                     config_.min_range_m, " to ", config_.max_range_m, " m"));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("none of the mapping drive's ", report_.scans, " LRF scans could be used; ",
                   scans_without_odometry_, " were taken at a time without odometry"));
}

}  // namespace soundmap::mapping
