#include "mapping/floor_plan_mapper.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cmath>
#include <cstdint>
#include <deque>
#include <utility>

#include "absl/strings/str_cat.h"
#include "frames/laser_lag.h"
#include "frames/odometry_track.h"
#include "geometry/angles.h"
#include "mapping/laser_lines.h"
#include "mapping/laser_loops.h"
#include "mapping/laser_matching.h"
#include "mapping/laser_plan.h"
#include "mapping/laser_search.h"
#include "mapping/surveyed_poses.h"

namespace soundmap::mapping {
namespace {

using frames::SecondsFromNs;
using frames::TimeNs;
using geometry::Pose2;

// Scans that wait for the odometry of their end; more than this and the odometry is taken to have
// ended.
constexpr std::size_t kMaxWaitingScans = 256;
constexpr TimeNs kMaxStamp_ns = TimeNs{1} << 62;
constexpr double kHoldOdometry_s = 0.2;
// Odometry of two stamps close together may differ by this without being a fault.
constexpr double kJitter_m = 0.05;
constexpr double kJitter_rad = 0.05;
constexpr double kMaxTilt_rad = 0.175;

// One point in each square of this size is enough to align a scan.
constexpr float kMatchedPoints_m = 0.05f;
// Below this a match is not believed.
constexpr int kMinInliers = 20;
constexpr double kMinFit = 0.5;
// Below this the search is widened.
constexpr double kGoodFit = 0.7;
constexpr double kGoodOverlap = 0.5;
constexpr double kWideSearch_m = 1.0;
// Of a larger step the odometry is not trusted to be near enough.
constexpr double kSmallStep_rad = 0.5;
constexpr double kSmallStep_s = 1.0;
constexpr double kLargeStepVariance = 0.25;
constexpr double kWideSearch_rad = 0.35;
constexpr double kMaxWideSearch = 4.0;  // times as wide after scans that fitted nothing
constexpr double kWideSearchCell_m = 0.1;
constexpr double kMinScore = 0.5;
// How far a robot can be from where it would be had it gone on as before.
constexpr double kMaxCarryOn = 5.0;  // times the last step
constexpr TimeNs kBurst_ns = 1'000'000'000;
constexpr double kJolt_m = 0.15;
constexpr double kJolt_rad = 0.15;
constexpr double kMaxAcceleration_mps2 = 5.0;
constexpr double kMaxAcceleration_radps2 = 15.0;

// Odometry errs by this part of its step, and at least by the first figure.
constexpr double kPriorMin_m = 0.05;
constexpr double kPriorMin_rad = 0.02;
constexpr double kPriorOfStep = 0.2;
// A matched scan, however well it fits.
constexpr double kMatchStd_m = 0.003;
constexpr double kMatchStd_rad = 0.0005;
// A way by odometry alone counts as so many times as long for the search for loops.
constexpr double kUnregisteredWay = 5.0;
constexpr double kUnregisteredVariance = 10.0;

// Scans further apart do not tell when a turn began.
constexpr TimeNs kMaxLagStep_ns = 1'000'000'000;
constexpr double kMaxLagStd_s = 0.01;

constexpr double kPlace_m = 1.0;

struct WaitingScan {
  frames::LaserScan scan;
  TimeNs end_ns = 0;
};

// A scan that was used.
struct PathEntry {
  TimeNs stamp_ns = 0;
  Pose2 odom_from_base;
  Pose2 map_from_base;
  std::optional<std::size_t> key_scan;  // the last one at or before this scan
};

bool IsFinite(const Pose2& pose) {
  return std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.yaw_rad);
}

double Distance(const Pose2& a, const Pose2& b) { return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m); }

// The walls seen from the last metres of the way: one map to align to, and another begun later that
// takes its place when the first covers the whole length.
class LocalMap {
 public:
  LocalMap(double piece_m, double length_m)
      : piece_m_(piece_m), length_m_(length_m), current_(piece_m), next_(piece_m) {}

  void Insert(std::span<const Eigen::Vector2f> point_in_map, double way_m) {
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
  const LineMap& lines() const { return current_; }

 private:
  double piece_m_;
  double length_m_;
  LineMap current_;
  LineMap next_;
  double current_from_m_ = 0.0;
  double next_from_m_ = 0.0;
};

}  // namespace

class FloorPlanMapper::Drive {
 public:
  using Progress = std::function<bool(double)>;

  Drive(const FloorPlanMapperConfig& config, const frames::Calibration& calibration,
        const Pose2& map_from_base, SurveyedPoses surveyed)
      : config_(config),
        calibration_(calibration),
        start_map_from_base_(map_from_base),
        lag_ns_(frames::NsFromSeconds(config.laser_lag_s.value_or(0.0))),
        surveyed_(std::move(surveyed)),
        local_map_(config.wall_piece_m, config.local_map_m) {}

  absl::Status Add(const frames::Odometry& odometry);
  absl::Status Add(const frames::LaserScan& scan);
  absl::StatusOr<FloorPlanResult> Finish(const Progress& progress);

 private:
  bool IsSound(const Pose2& step, TimeNs duration_ns) const;
  void ProcessWaiting(bool all);
  void Process(const WaitingScan& waiting);
  Pose2 Predict(TimeNs stamp_ns, const Pose2& odom_from_base, bool& odometry_is_sound) const;
  LaserMatch Align(const std::vector<Eigen::Vector2f>& point_in_base, const Pose2& predicted,
                   const Pose2& odom_from_base, TimeNs stamp_ns, bool odometry_is_sound) const;
  void Keep(const PathEntry& entry, LaserPoints points, std::vector<Eigen::Vector2f> to_match);
  bool HasMoved(const Pose2& map_from_base) const;
  bool TakePlace(const Pose2& map_from_base);
  absl::Status ApplySurveyedPoses();
  absl::Status CloseLoopsAndRelax(const Progress& progress);
  absl::Status Relax(const Progress& progress);
  void PlacePath();
  absl::Status NothingToMap() const;

  const FloorPlanMapperConfig config_;
  const frames::Calibration calibration_;
  const Pose2 start_map_from_base_;
  TimeNs lag_ns_;
  frames::LaserLag lag_;
  SurveyedPoses surveyed_;
  frames::OdometryTrack registered_;  // the path of the scans; better than the odometry

  frames::OdometryTrack track_;
  std::optional<Pose2> first_odom_from_base_;
  std::deque<WaitingScan> waiting_;
  LocalMap local_map_;
  std::optional<Pose2> inserted_at_;  // the last scan in the local map
  std::vector<PathEntry> path_;
  std::vector<LaserKeyScan> key_scans_;
  // Since the last key scan.
  double way_m_ = 0.0;
  int unregistered_in_a_row_ = 0;
  Eigen::Matrix3d match_covariance_ = Eigen::Matrix3d::Zero();  // of the last scan
  Eigen::Matrix3d unregistered_covariance_ = Eigen::Matrix3d::Zero();
  boost::unordered_flat_map<std::int64_t, int> places_;
  FloorPlanReport report_;
  int scans_without_points_ = 0;
  int scans_without_odometry_ = 0;
  bool finished_ = false;
};

absl::Status FloorPlanMapper::Drive::Add(const frames::Odometry& odometry) {
  if (odometry.stamp_ns < 0 || odometry.stamp_ns > kMaxStamp_ns) {
    return absl::InvalidArgumentError("an odometry frame's stamp is out of range");
  }
  if (!track_.Add(odometry)) return absl::OkStatus();
  if (!first_odom_from_base_) first_odom_from_base_ = odometry.odom_from_base;
  lag_.Follow(track_);
  ProcessWaiting(/*all=*/false);
  return absl::OkStatus();
}

absl::Status FloorPlanMapper::Drive::Add(const frames::LaserScan& scan) {
  ++report_.scans;
  if (scan.stamp_ns < 0 || scan.stamp_ns > kMaxStamp_ns) {
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

void FloorPlanMapper::Drive::ProcessWaiting(bool all) {
  while (!waiting_.empty()) {
    const bool covered = !track_.empty() && track_.newest_ns() >= waiting_.front().end_ns - lag_ns_;
    if (!covered && !all && waiting_.size() <= kMaxWaitingScans) return;
    Process(waiting_.front());
    waiting_.pop_front();
  }
}

void FloorPlanMapper::Drive::Process(const WaitingScan& waiting) {
  PathEntry entry;
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
    const double prior_std_m = kPriorMin_m + kPriorOfStep * step_m;
    const double prior_std_rad =
        kPriorMin_rad +
        kPriorOfStep * std::abs(geometry::NormalizeAngle(entry.map_from_base.yaw_rad -
                                                         path_.back().map_from_base.yaw_rad));
    Eigen::Vector3d prior_weight(prior_std_m, prior_std_m, prior_std_rad);
    prior_weight = prior_weight.cwiseProduct(prior_weight).cwiseInverse().eval();
    const LaserMatch match =
        Align(to_match, entry.map_from_base, *odom_from_base, entry.stamp_ns, odometry_is_sound);
    Eigen::Matrix3d information = prior_weight.asDiagonal();
    if (match.inliers >= kMinInliers && match.fit() >= kMinFit) {
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
      placed = odometry_is_sound && match.constraints < kMinInliers;
      ++unregistered_in_a_row_;
      unregistered_covariance_ += kUnregisteredVariance * information.inverse();
      way_m_ += kUnregisteredWay * Distance(path_.back().map_from_base, entry.map_from_base);
    }
  }
  if (placed && HasMoved(entry.map_from_base)) {
    inserted_at_ = entry.map_from_base;
    std::vector<Eigen::Vector2f> in_map;
    const Eigen::Isometry2f map_from_base =
        Eigen::Translation2f(static_cast<float>(entry.map_from_base.x_m),
                             static_cast<float>(entry.map_from_base.y_m)) *
        Eigen::Rotation2Df(static_cast<float>(entry.map_from_base.yaw_rad));
    for (const Eigen::Vector2f& point : points->point_in_base) {
      in_map.push_back(map_from_base * point);
    }
    local_map_.Insert(in_map, way_m_);
    if (TakePlace(entry.map_from_base)) {
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
  if (surveyed_.empty()) return;
  registered_.Add({entry.stamp_ns, entry.map_from_base});
  surveyed_.Follow(registered_);
}

void FloorPlanMapper::Drive::Keep(const PathEntry& entry, LaserPoints points,
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

bool FloorPlanMapper::Drive::IsSound(const Pose2& step, TimeNs duration_ns) const {
  const double duration_s = SecondsFromNs(duration_ns);
  return std::hypot(step.x_m, step.y_m) <= config_.max_speed_mps * duration_s + kJitter_m &&
         std::abs(step.yaw_rad) <= config_.max_turn_rate_radps * duration_s + kJitter_rad;
}

Pose2 FloorPlanMapper::Drive::Predict(TimeNs stamp_ns, const Pose2& odom_from_base,
                                      bool& odometry_is_sound) const {
  if (path_.empty()) {
    return start_map_from_base_ * first_odom_from_base_->Inverse() * odom_from_base;
  }
  const PathEntry& last = path_.back();
  const Pose2 last_from_base = last.odom_from_base.Inverse() * odom_from_base;
  odometry_is_sound = IsSound(last_from_base, stamp_ns - last.stamp_ns);
  return odometry_is_sound ? last.map_from_base * last_from_base : last.map_from_base;
}

LaserMatch FloorPlanMapper::Drive::Align(const std::vector<Eigen::Vector2f>& point_in_base,
                                         const Pose2& predicted, const Pose2& odom_from_base,
                                         TimeNs stamp_ns, bool odometry_is_sound) const {
  const PathEntry& last = path_.back();
  const double step_m = Distance(predicted, last.map_from_base);
  const double step_rad =
      std::abs(geometry::NormalizeAngle(predicted.yaw_rad - last.map_from_base.yaw_rad));
  const LaserSearchRange near{.start_distance_m = 0.3,
                              .prior_std_m = kPriorMin_m + kPriorOfStep * step_m,
                              .prior_std_rad = kPriorMin_rad + kPriorOfStep * step_rad};
  const LineMap& lines = local_map_.lines();
  // Where the robot would be if it had gone on as before. It cannot be far from there.
  const double duration_s = SecondsFromNs(stamp_ns - last.stamp_ns);
  Pose2 carried_on = last.map_from_base;
  if (path_.size() >= 2) {
    const PathEntry& before = path_[path_.size() - 2];
    const double fraction = duration_s / SecondsFromNs(last.stamp_ns - before.stamp_ns);
    if (fraction < kMaxCarryOn) {
      carried_on = last.map_from_base *
                   geometry::Interpolate(
                       Pose2{}, before.map_from_base.Inverse() * last.map_from_base, fraction);
    }
  }
  // Where the odometry of the last second puts it: odometry may come late and in bursts.
  std::size_t earlier = path_.size() - 1;
  while (earlier > 0 && stamp_ns - path_[earlier].stamp_ns < kBurst_ns) --earlier;
  const Pose2 over_a_second =
      path_[earlier].map_from_base * path_[earlier].odom_from_base.Inverse() * odom_from_base;
  const auto is_near = [squared_s2 = duration_s * duration_s](const Pose2& a, const Pose2& b) {
    const Pose2 off = a.Inverse() * b;
    return std::hypot(off.x_m, off.y_m) <= kJolt_m + kMaxAcceleration_mps2 * squared_s2 &&
           std::abs(off.yaw_rad) <= kJolt_rad + kMaxAcceleration_radps2 * squared_s2;
  };
  const auto is_possible = [&](const Pose2& map_from_base) {
    return unregistered_in_a_row_ > 0 || is_near(carried_on, map_from_base) ||
           (odometry_is_sound && is_near(predicted, map_from_base)) ||
           is_near(over_a_second, map_from_base);
  };
  const auto is_good = [&](const LaserMatch& match) {
    return match.fit() >= kGoodFit && match.overlap() >= kGoodOverlap &&
           is_possible(match.map_from_base);
  };
  LaserMatch best = MatchToLines(point_in_base, lines, predicted, near);
  const bool is_small = step_rad <= kSmallStep_rad && duration_s <= kSmallStep_s;
  if (odometry_is_sound && is_small && is_good(best)) return best;
  if (!is_possible(best.map_from_base)) best.inliers = 0;
  const auto try_also = [&](const Pose2& start, const LaserSearchRange& range) {
    const LaserMatch other = MatchToLines(point_in_base, lines, start, range);
    if (other.inliers > best.inliers * 5 / 4 && is_possible(other.map_from_base)) best = other;
  };
  // The odometry may have stopped, jumped or slipped, or catch up on what it had not told before.
  const LaserSearchRange wide{
      .start_distance_m = 0.5, .prior_std_m = kWideSearch_m, .prior_std_rad = kWideSearch_rad};
  for (const Pose2& start : {predicted, over_a_second, last.map_from_base, carried_on}) {
    try_also(start, wide);
  }
  if (is_small && is_good(best)) return best;
  std::vector<Eigen::Vector2f> means;
  for (const LinePiece& piece : lines.pieces()) means.push_back(piece.mean);
  const LaserSearch search(means, kWideSearchCell_m);
  const double growth = std::min(1.0 + 0.5 * unregistered_in_a_row_, kMaxWideSearch);
  const auto found = search.Find(
      point_in_base, carried_on,
      {.distance_m = growth * kWideSearch_m, .angle_rad = growth * kWideSearch_rad}, kMinScore);
  if (found && found->unique) {
    try_also(
        found->map_from_base,
        {.start_distance_m = 0.3, .prior_std_m = kWideSearch_m, .prior_std_rad = kWideSearch_rad});
  }
  return best;
}

bool FloorPlanMapper::Drive::HasMoved(const Pose2& map_from_base) const {
  if (!inserted_at_) return true;
  const Pose2 step = inserted_at_->Inverse() * map_from_base;
  return std::hypot(step.x_m, step.y_m) >= config_.key_scan_distance_m ||
         std::abs(step.yaw_rad) >= config_.key_scan_angle_rad;
}

bool FloorPlanMapper::Drive::TakePlace(const Pose2& map_from_base) {
  const auto square = SquareOf(
      Eigen::Vector2f(static_cast<float>(map_from_base.x_m), static_cast<float>(map_from_base.y_m)),
      kPlace_m);
  if (!square) return false;
  const int quarter = static_cast<int>(std::floor(map_from_base.yaw_rad / (geometry::kPi / 2.0)));
  int& taken = places_[KeyOf(Square(4 * square->x() + (quarter & 3), square->y()))];
  if (taken >= config_.key_scans_per_place) return false;
  ++taken;
  return true;
}

absl::Status FloorPlanMapper::Drive::ApplySurveyedPoses() {
  std::vector<PathEntry> path;
  std::vector<LaserKeyScan> key_scans;
  std::size_t next_key_scan = 0;
  for (std::size_t i = 0; i < path_.size(); ++i) {
    const bool is_key_scan =
        next_key_scan < key_scans_.size() && key_scans_[next_key_scan].path_index == i;
    const std::size_t key_scan = is_key_scan ? next_key_scan++ : 0;
    const auto placed = surveyed_.At(path_[i].stamp_ns, path_[i].map_from_base);
    if (!placed) {
      ++report_.scans_dropped;
      continue;
    }
    if (is_key_scan) {
      key_scans_[key_scan].path_index = path.size();
      key_scans_[key_scan].map_from_base = *placed;
      key_scans.push_back(std::move(key_scans_[key_scan]));
    }
    path.push_back(path_[i]);
    path.back().map_from_base = *placed;
  }
  path_ = std::move(path);
  key_scans_ = std::move(key_scans);
  if (key_scans_.empty()) {
    return absl::InvalidArgumentError(
        "no LRF scan of the mapping drive lies between two of the surveyed poses");
  }
  return absl::OkStatus();
}

// Aligns every key scan to the walls of all of them, with the first as the anchor.
absl::Status FloorPlanMapper::Drive::Relax(const Progress& progress) {
  for (int pass = 0; pass < config_.relaxation_passes; ++pass) {
    LineMap lines(config_.wall_piece_m);
    std::vector<Eigen::Vector2f> in_map;
    for (const LaserKeyScan& key_scan : key_scans_) {
      in_map.clear();
      const Eigen::Isometry2f map_from_base =
          Eigen::Translation2f(static_cast<float>(key_scan.map_from_base.x_m),
                               static_cast<float>(key_scan.map_from_base.y_m)) *
          Eigen::Rotation2Df(static_cast<float>(key_scan.map_from_base.yaw_rad));
      for (const Eigen::Vector2f& point : key_scan.points.point_in_base) {
        in_map.push_back(map_from_base * point);
      }
      lines.Insert(in_map);
    }
    lines.FitLines();
    std::vector<Pose2> aligned;
    double residual_sum_m = 0.0;
    for (const LaserKeyScan& key_scan : key_scans_) {
      const LaserMatch match = MatchToLines(key_scan.point_to_match, lines, key_scan.map_from_base,
                                            {.start_distance_m = config_.wall_piece_m,
                                             .prior_std_m = kPriorMin_m,
                                             .prior_std_rad = kPriorMin_rad});
      aligned.push_back(match.map_from_base);
      residual_sum_m += match.mean_residual_m;
      const double done = (pass + static_cast<double>(aligned.size()) / key_scans_.size()) /
                          config_.relaxation_passes;
      if (progress && !progress(0.6 + 0.2 * done)) {
        return absl::CancelledError("the mapping was cancelled");
      }
    }
    report_.mean_residual_m = residual_sum_m / static_cast<double>(key_scans_.size());
    const Pose2 anchored_from_aligned =
        key_scans_.front().map_from_base * aligned.front().Inverse();
    for (std::size_t i = 0; i < key_scans_.size(); ++i) {
      key_scans_[i].map_from_base = anchored_from_aligned * aligned[i];
    }
  }
  return absl::OkStatus();
}

// Scans between two key scans move as they were placed at first, and what is left is spread over
// them in time.
void FloorPlanMapper::Drive::PlacePath() {
  std::vector<Pose2> before;
  for (const LaserKeyScan& key_scan : key_scans_) {
    before.push_back(path_[key_scan.path_index].map_from_base);
  }
  for (PathEntry& entry : path_) {
    const std::size_t begin = entry.key_scan.value_or(0);
    const LaserKeyScan& first = key_scans_[begin];
    if (!entry.key_scan || begin + 1 == key_scans_.size()) {
      entry.map_from_base = first.map_from_base * before[begin].Inverse() * entry.map_from_base;
      continue;
    }
    const LaserKeyScan& second = key_scans_[begin + 1];
    const TimeNs begin_ns = path_[first.path_index].stamp_ns;
    const TimeNs end_ns = path_[second.path_index].stamp_ns;
    entry.map_from_base = Between(
        first.map_from_base, before[begin], second.map_from_base, before[begin + 1],
        entry.map_from_base,
        static_cast<double>(entry.stamp_ns - begin_ns) / static_cast<double>(end_ns - begin_ns));
  }
}

absl::Status FloorPlanMapper::Drive::NothingToMap() const {
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

absl::Status FloorPlanMapper::Drive::CloseLoopsAndRelax(const Progress& progress) {
  const Progress loop_progress = [&progress](double done) {
    return !progress || progress(0.6 * done);
  };
  LoopReport loops;
  absl::Status status = CloseLoops(config_, loop_progress, key_scans_, loops);
  if (status.ok()) status = Relax(progress);
  if (!status.ok()) return status;
  report_.loops_closed = loops.loops_closed;
  report_.loops_refused = loops.loops_refused;
  PlacePath();
  return absl::OkStatus();
}

absl::StatusOr<FloorPlanResult> FloorPlanMapper::Drive::Finish(const Progress& progress) {
  if (finished_) return absl::FailedPreconditionError("the mapping is finished already");
  finished_ = true;
  ProcessWaiting(/*all=*/true);
  if (key_scans_.empty()) return NothingToMap();
  const absl::Status placed =
      surveyed_.empty() ? CloseLoopsAndRelax(progress) : ApplySurveyedPoses();
  if (!placed.ok()) return placed;
  auto floor_plan = DrawFloorPlan(config_, key_scans_, [&progress](double done) {
    return !progress || progress(0.8 + 0.2 * done);
  });
  if (!floor_plan.ok()) return floor_plan.status();

  report_.laser_lag_s = SecondsFromNs(lag_ns_);
  FloorPlanResult result{{nullptr, *std::move(floor_plan)}, report_};
  result.report.key_scans = static_cast<int>(key_scans_.size());
  for (const PathEntry& entry : path_) {
    result.report.path.push_back({entry.stamp_ns, entry.map_from_base});
  }
  const Pose2 end_by_odometry = path_.front().map_from_base *
                                path_.front().odom_from_base.Inverse() *
                                path_.back().odom_from_base;
  result.report.drift_removed_m = Distance(end_by_odometry, path_.back().map_from_base);
  return result;
}

absl::StatusOr<FloorPlanMapper> FloorPlanMapper::Create(const FloorPlanMapperConfig& config,
                                                        const frames::Calibration& calibration,
                                                        const Pose2& map_from_base,
                                                        std::vector<StampedPose> surveyed) {
  for (const absl::Status& status : {config.Validate(), calibration.Validate()}) {
    if (!status.ok()) return status;
  }
  if (!IsFinite(map_from_base)) {
    return absl::InvalidArgumentError("the mapping drive's initial pose is not finite");
  }
  const double upright = std::abs(calibration.base_from_laser.linear()(2, 2));
  if (!(upright >= std::cos(kMaxTilt_rad))) {
    return absl::InvalidArgumentError(
        absl::StrCat("the LRF is tilted by ",
                     std::lround(geometry::DegFromRad(std::acos(std::min(upright, 1.0)))),
                     " degrees; a floor plan needs it level within 10"));
  }
  auto poses = SurveyedPoses::Create(std::move(surveyed));
  if (!poses.ok()) return poses.status();
  return FloorPlanMapper(
      std::make_unique<Drive>(config, calibration, map_from_base, *std::move(poses)));
}

FloorPlanMapper::FloorPlanMapper(std::unique_ptr<Drive> drive) : drive_(std::move(drive)) {}
FloorPlanMapper::FloorPlanMapper(FloorPlanMapper&&) noexcept = default;
FloorPlanMapper& FloorPlanMapper::operator=(FloorPlanMapper&&) noexcept = default;
FloorPlanMapper::~FloorPlanMapper() = default;

absl::Status FloorPlanMapper::Add(const frames::Frame& frame) {
  if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) return drive_->Add(*odometry);
  if (const auto* scan = std::get_if<frames::LaserScan>(&frame)) return drive_->Add(*scan);
  return absl::OkStatus();
}

absl::StatusOr<FloorPlanResult> FloorPlanMapper::Finish(
    const std::function<bool(double)>& progress) {
  return drive_->Finish(progress);
}

}  // namespace soundmap::mapping
