#include "mapping/mapper.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <array>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cmath>
#include <cstdint>
#include <deque>
#include <utility>

#include "absl/strings/str_cat.h"
#include "frames/odometry_track.h"
#include "geometry/angles.h"
#include "mapping/point_thinning.h"
#include "mapping/registration.h"
#include "mapping/surface_map.h"

namespace soundmap::mapping {
namespace {

using frames::SecondsFromNs;
using frames::TimeNs;
using geometry::Pose2;

// Scans that wait for the odometry of their end; more than this and the odometry is taken to have
// ended.
constexpr std::size_t kMaxWaitingScans = 32;
// Stamps up to the year 2116, so that sums of them do not overflow.
constexpr TimeNs kMaxStamp_ns = TimeNs{1} << 62;
constexpr double kHoldOdometry_s = 0.2;
// Odometry of two stamps close together may differ by this without being a fault.
constexpr double kJitter_m = 0.05;
constexpr double kJitter_rad = 0.05;

// A sweep is cut into so many parts of equal time; the LIDAR's place is one for each.
constexpr int kSweepParts = 16;

// One point in each such part of a surface voxel is enough to align a scan.
constexpr double kAlignedPoints_voxels = 0.75;

// Below this a registration is not believed.
constexpr int kMinInliers = 30;
constexpr double kMinFit = 0.5;
// Below this the search is widened.
constexpr double kGoodFit = 0.7;
constexpr double kGoodOverlap = 0.5;
constexpr double kWideSearch_m = 1.0;

// Odometry errs by this part of its step, and at least by the first figure.
constexpr double kPriorMin_m = 0.03;
constexpr double kPriorMin_rad = 0.02;
constexpr double kPriorOfStep = 0.2;

constexpr double kPlace_m = 1.0;

// At most so much of a ray is taken to graze its surface.
constexpr double kMaxMargin_m = 1.0;

// An LRF mounted lower than this is none.
constexpr double kMinLaserHeight_m = 0.05;

struct WaitingScan {
  frames::LidarScan scan;  // points in range only
  TimeNs end_ns = 0;
};

struct KeyScan {
  std::size_t path_index = 0;
  std::vector<Eigen::Vector3f> point_in_base;  // one a voxel
  std::vector<std::uint8_t> part;              // of the sweep, for each point
  std::array<Eigen::Vector3f, kSweepParts> lidar_in_base;
};

// A scan that was used.
struct PathEntry {
  TimeNs stamp_ns = 0;
  Pose2 odom_from_base;
  Pose2 map_from_base;
  std::optional<std::size_t> key_scan;  // the last one at or before this scan
};

struct SurveyedPose {
  StampedPose pose;
  std::optional<Pose2> odom_from_base;
};

bool IsFinite(const Pose2& pose) {
  return std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.yaw_rad);
}

double Distance(const Pose2& a, const Pose2& b) { return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m); }

std::vector<Eigen::Vector3f> Select(std::span<const Eigen::Vector3f> points,
                                    std::span<const std::uint32_t> indices) {
  std::vector<Eigen::Vector3f> selected;
  selected.reserve(indices.size());
  for (const std::uint32_t i : indices) selected.push_back(points[i]);
  return selected;
}

std::vector<Eigen::Vector3f> Transform(const Pose2& map_from_base,
                                       std::span<const Eigen::Vector3f> point_in_base) {
  const Eigen::Isometry3f transform = map_from_base.ToIsometry().cast<float>();
  std::vector<Eigen::Vector3f> point_in_map;
  point_in_map.reserve(point_in_base.size());
  for (const Eigen::Vector3f& point : point_in_base) point_in_map.push_back(transform * point);
  return point_in_map;
}

}  // namespace

absl::Status MapperConfig::Validate() const {
  const auto within = [](double value, double low, double high) {
    return value >= low && value <= high;  // false for NaN
  };
  if (!within(voxel_size_m, 0.01, 1.0)) {
    return absl::InvalidArgumentError("the mapping's voxel_size_m must be from 0.01 to 1 m");
  }
  if (!within(min_range_m, 0.0, 100.0) || !within(max_range_m, 0.5, 500.0) ||
      min_range_m >= max_range_m) {
    return absl::InvalidArgumentError(
        "the mapping's min_range_m and max_range_m must be in order, the latter from 0.5 to 500 m");
  }
  if (!within(slice_half_thickness_m, 0.0, 5.0) || !within(slice_height_without_lrf_m, -100, 100) ||
      (slice_height_m && !within(*slice_height_m, -100, 100))) {
    return absl::InvalidArgumentError(
        "the mapping's slice must be within 100 m of the floor and at most 10 m thick");
  }
  if (!within(surface_voxel_size_m, 0.05, 2.0)) {
    return absl::InvalidArgumentError(
        "the mapping's surface_voxel_size_m must be from 0.05 to 2 m");
  }
  if (!within(key_scan_distance_m, 0.0, 10.0) || !within(key_scan_angle_rad, 0.0, 4.0) ||
      key_scans_per_place < 1 || key_scans_per_place > 1000) {
    return absl::InvalidArgumentError(
        "the mapping's key scans must be at most 10 m and 4 rad apart, 1 to 1000 a place");
  }
  if (relaxation_passes < 0 || relaxation_passes > 100) {
    return absl::InvalidArgumentError("the mapping's relaxation_passes must be from 0 to 100");
  }
  if (!within(max_speed_mps, 0.01, 100.0) || !within(max_turn_rate_radps, 0.01, 100.0)) {
    return absl::InvalidArgumentError(
        "the mapping's max_speed_mps and max_turn_rate_radps must be from 0.01 to 100");
  }
  return occupancy.Validate();
}

class Mapper::Drive {
 public:
  Drive(const MapperConfig& config, const frames::Calibration& calibration,
        const Pose2& map_from_base, std::vector<StampedPose> surveyed)
      : config_(config),
        calibration_(calibration),
        start_map_from_base_(map_from_base),
        surfaces_(config.surface_voxel_size_m) {
    for (const StampedPose& pose : surveyed) surveyed_.push_back({pose, std::nullopt});
  }

  absl::Status Add(const frames::Odometry& odometry);
  absl::Status Add(const frames::LidarScan& scan);
  absl::StatusOr<MappingResult> Finish(const std::function<bool(double)>& progress);

 private:
  using Progress = std::function<bool(double)>;

  bool IsSound(const Pose2& step, TimeNs duration_ns) const;
  void ProcessWaiting(bool all);
  void Process(const WaitingScan& waiting);
  Pose2 Predict(TimeNs stamp_ns, const Pose2& odom_from_base, bool& odometry_is_sound) const;
  Registration Align(std::span<const Eigen::Vector3f> point_in_base, const Pose2& predicted,
                     TimeNs stamp_ns, bool odometry_is_sound) const;
  bool IsKeyScan(const PathEntry& entry) const;
  bool TakePlace(const Pose2& map_from_base);
  KeyScan MakeKeyScan(const frames::LidarScan& scan, TimeNs end_ns, const PathEntry& entry,
                      std::span<const Eigen::Vector3f> point_in_base) const;
  std::vector<Eigen::Vector3f> PointsToAlign(std::span<const Eigen::Vector3f> point_in_base) const;
  SurfaceMap MapOfKeyScans() const;
  absl::Status ApplySurveyedPoses();
  absl::Status Relax(const Progress& progress);
  absl::StatusOr<std::shared_ptr<octomap::OcTree>> CastRays(const Progress& progress) const;
  absl::StatusOr<building::FloorPlan> Slice(const octomap::OcTree& octree) const;
  absl::Status NothingToMap() const;

  Pose2& PoseOf(const KeyScan& key_scan) { return path_[key_scan.path_index].map_from_base; }
  const Pose2& PoseOf(const KeyScan& key_scan) const {
    return path_[key_scan.path_index].map_from_base;
  }

  const MapperConfig config_;
  const frames::Calibration calibration_;
  const Pose2 start_map_from_base_;
  std::vector<SurveyedPose> surveyed_;
  std::size_t surveyed_passed_ = 0;

  frames::OdometryTrack track_;
  std::optional<Pose2> first_odom_from_base_;
  // The last step of the odometry that no robot can take.
  TimeNs jump_begin_ns_ = 0;
  TimeNs jump_end_ns_ = 0;
  std::deque<WaitingScan> waiting_;
  SurfaceMap surfaces_;
  std::vector<PathEntry> path_;
  std::vector<KeyScan> key_scans_;
  boost::unordered_flat_map<geometry::VoxelKey, int, std::hash<geometry::VoxelKey>> places_;
  MappingReport report_;
  int scans_without_points_ = 0;
  int scans_without_odometry_ = 0;
  bool finished_ = false;
};

absl::Status Mapper::Drive::Add(const frames::Odometry& odometry) {
  if (odometry.stamp_ns < 0 || odometry.stamp_ns > kMaxStamp_ns) {
    return absl::InvalidArgumentError("an odometry frame's stamp is out of range");
  }
  const std::optional<frames::Odometry> before =
      track_.empty() ? std::nullopt : std::optional(track_.entries().back());
  if (!track_.Add(odometry)) return absl::OkStatus();
  if (before && !IsSound(before->odom_from_base.Inverse() * odometry.odom_from_base,
                         odometry.stamp_ns - before->stamp_ns)) {
    jump_begin_ns_ = before->stamp_ns;
    jump_end_ns_ = odometry.stamp_ns;
  }
  if (!first_odom_from_base_) first_odom_from_base_ = odometry.odom_from_base;
  while (surveyed_passed_ < surveyed_.size() &&
         surveyed_[surveyed_passed_].pose.stamp_ns <= odometry.stamp_ns) {
    SurveyedPose& surveyed = surveyed_[surveyed_passed_++];
    surveyed.odom_from_base = track_.Near(surveyed.pose.stamp_ns, kHoldOdometry_s);
  }
  ProcessWaiting(/*all=*/false);
  return absl::OkStatus();
}

absl::Status Mapper::Drive::Add(const frames::LidarScan& scan) {
  ++report_.scans;
  if (scan.stamp_ns < 0 || scan.stamp_ns > kMaxStamp_ns) {
    ++report_.scans_dropped;
    return absl::InvalidArgumentError("a LIDAR scan's stamp is out of range");
  }
  if (!scan.time_offset_ns.empty() && scan.time_offset_ns.size() != scan.point_in_lidar.size()) {
    ++report_.scans_dropped;
    return absl::InvalidArgumentError("a LIDAR scan has not one time offset a point");
  }
  WaitingScan waiting;
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
    ++report_.scans_dropped;
    ++scans_without_points_;
    return absl::OkStatus();
  }
  waiting_.push_back(std::move(waiting));
  ProcessWaiting(/*all=*/false);
  return absl::OkStatus();
}

void Mapper::Drive::ProcessWaiting(bool all) {
  while (!waiting_.empty()) {
    const bool covered = !track_.empty() && track_.newest_ns() >= waiting_.front().end_ns;
    if (!covered && !all && waiting_.size() <= kMaxWaitingScans) return;
    Process(waiting_.front());
    waiting_.pop_front();
  }
}

void Mapper::Drive::Process(const WaitingScan& waiting) {
  PathEntry entry;
  entry.stamp_ns = waiting.scan.stamp_ns + (waiting.end_ns - waiting.scan.stamp_ns) / 2;
  const auto odom_from_base = track_.Near(entry.stamp_ns, kHoldOdometry_s);
  const auto points =
      frames::PointsInBaseAt(waiting.scan, calibration_.base_from_lidar, track_, entry.stamp_ns);
  if (!odom_from_base || !points) {
    ++report_.scans_dropped;
    ++scans_without_odometry_;
    return;
  }
  // A sweep in which the odometry jumped is bent beyond use.
  const bool bent = waiting.scan.stamp_ns < jump_end_ns_ && waiting.end_ns > jump_begin_ns_;
  if (bent || (!path_.empty() && entry.stamp_ns <= path_.back().stamp_ns)) {
    ++report_.scans_dropped;
    return;
  }
  entry.odom_from_base = *odom_from_base;
  bool odometry_is_sound = true;
  entry.map_from_base = Predict(entry.stamp_ns, *odom_from_base, odometry_is_sound);
  if (!path_.empty()) entry.key_scan = path_.back().key_scan;

  bool placed = true;
  if (surveyed_.empty() && surfaces_.size() > 0) {
    const Registration registration =
        Align(PointsToAlign(*points), entry.map_from_base, entry.stamp_ns, odometry_is_sound);
    if (registration.inliers >= kMinInliers && registration.fit() >= kMinFit) {
      entry.map_from_base = registration.map_from_base;
    } else {
      ++report_.scans_unregistered;
      // By odometry where nothing speaks against it: a new part of the building, or one without
      // walls.
      placed = odometry_is_sound && registration.constraints < kMinInliers;
    }
  }
  if (placed && IsKeyScan(entry) && TakePlace(entry.map_from_base)) {
    KeyScan key_scan = MakeKeyScan(waiting.scan, waiting.end_ns, entry, *points);
    if (surveyed_.empty()) {
      surfaces_.Insert(Transform(entry.map_from_base, key_scan.point_in_base));
      surfaces_.FitPlanes();
    }
    entry.key_scan = key_scans_.size();
    key_scans_.push_back(std::move(key_scan));
  }
  path_.push_back(entry);
}

bool Mapper::Drive::IsSound(const Pose2& step, TimeNs duration_ns) const {
  const double duration_s = SecondsFromNs(duration_ns);
  return std::hypot(step.x_m, step.y_m) <= config_.max_speed_mps * duration_s + kJitter_m &&
         std::abs(step.yaw_rad) <= config_.max_turn_rate_radps * duration_s + kJitter_rad;
}

Pose2 Mapper::Drive::Predict(TimeNs stamp_ns, const Pose2& odom_from_base,
                             bool& odometry_is_sound) const {
  if (path_.empty()) {
    return start_map_from_base_ * first_odom_from_base_->Inverse() * odom_from_base;
  }
  const PathEntry& last = path_.back();
  const Pose2 last_from_base = last.odom_from_base.Inverse() * odom_from_base;
  odometry_is_sound = IsSound(last_from_base, stamp_ns - last.stamp_ns);
  return odometry_is_sound ? last.map_from_base * last_from_base : last.map_from_base;
}

Registration Mapper::Drive::Align(std::span<const Eigen::Vector3f> point_in_base,
                                  const Pose2& predicted, TimeNs stamp_ns,
                                  bool odometry_is_sound) const {
  const PathEntry& last = path_.back();
  const double step_m = Distance(predicted, last.map_from_base);
  const double step_rad =
      std::abs(geometry::NormalizeAngle(predicted.yaw_rad - last.map_from_base.yaw_rad));
  const SearchRange near{.start_distance_m = 0.3,
                         .prior_std_m = kPriorMin_m + kPriorOfStep * step_m,
                         .prior_std_rad = kPriorMin_rad + kPriorOfStep * step_rad};
  Registration best = Register(point_in_base, surfaces_, predicted, near);
  if (!odometry_is_sound || best.fit() < kGoodFit || best.overlap < kGoodOverlap) {
    // The odometry may have jumped or slipped: search wider, and from where the robot would be if
    // it had stood or gone on as before.
    std::vector<Pose2> starts = {predicted, last.map_from_base};
    if (path_.size() >= 2) {
      const PathEntry& before = path_[path_.size() - 2];
      const double fraction = static_cast<double>(stamp_ns - before.stamp_ns) /
                              static_cast<double>(last.stamp_ns - before.stamp_ns);
      if (fraction < 5.0) {
        starts.push_back(geometry::Interpolate(before.map_from_base, last.map_from_base, fraction));
      }
    }
    const SearchRange wide{
        .start_distance_m = kWideSearch_m, .prior_std_m = 0.5, .prior_std_rad = 0.2};
    for (const Pose2& start : starts) {
      const Registration other = Register(point_in_base, surfaces_, start, wide);
      if (other.inliers > best.inliers * 5 / 4) best = other;
    }
  }
  return best;
}

bool Mapper::Drive::IsKeyScan(const PathEntry& entry) const {
  if (key_scans_.empty()) return true;
  // By odometry where registration is not used, since poses follow at the end.
  const PathEntry& last = path_[key_scans_.back().path_index];
  const Pose2 step = surveyed_.empty() ? last.map_from_base.Inverse() * entry.map_from_base
                                       : last.odom_from_base.Inverse() * entry.odom_from_base;
  return std::hypot(step.x_m, step.y_m) >= config_.key_scan_distance_m ||
         std::abs(step.yaw_rad) >= config_.key_scan_angle_rad;
}

bool Mapper::Drive::TakePlace(const Pose2& map_from_base) {
  const double quarter = std::floor(map_from_base.yaw_rad / (geometry::kPi / 2.0));
  const auto key = geometry::KeyFromPoint(
      Eigen::Vector3d(map_from_base.x_m, map_from_base.y_m, quarter * kPlace_m + kPlace_m / 2),
      kPlace_m);
  if (!key) return false;
  int& taken = places_[*key];
  if (taken >= config_.key_scans_per_place) return false;
  ++taken;
  return true;
}

KeyScan Mapper::Drive::MakeKeyScan(const frames::LidarScan& scan, TimeNs end_ns,
                                   const PathEntry& entry,
                                   std::span<const Eigen::Vector3f> point_in_base) const {
  KeyScan key_scan;
  key_scan.path_index = path_.size();
  const std::vector<std::uint32_t> indices = FirstPointPerCube(point_in_base, config_.voxel_size_m);
  key_scan.point_in_base = Select(point_in_base, indices);
  const TimeNs duration_ns = end_ns - scan.stamp_ns;
  key_scan.part.reserve(indices.size());
  for (const std::uint32_t i : indices) {
    const TimeNs offset_ns = scan.time_offset_ns.empty() ? 0 : TimeNs{scan.time_offset_ns[i]};
    key_scan.part.push_back(static_cast<std::uint8_t>(offset_ns * kSweepParts / (duration_ns + 1)));
  }
  for (int part = 0; part < kSweepParts; ++part) {
    const TimeNs middle_ns = scan.stamp_ns + duration_ns * (2 * part + 1) / (2 * kSweepParts);
    const Pose2 odom_from_part =
        track_.Near(middle_ns, kHoldOdometry_s).value_or(entry.odom_from_base);
    const Pose2 base_from_part = entry.odom_from_base.Inverse() * odom_from_part;
    key_scan.lidar_in_base[part] =
        (base_from_part.ToIsometry() * calibration_.base_from_lidar).translation().cast<float>();
  }
  return key_scan;
}

std::vector<Eigen::Vector3f> Mapper::Drive::PointsToAlign(
    std::span<const Eigen::Vector3f> point_in_base) const {
  return Select(point_in_base, FirstPointPerCube(point_in_base, kAlignedPoints_voxels *
                                                                    config_.surface_voxel_size_m));
}

SurfaceMap Mapper::Drive::MapOfKeyScans() const {
  SurfaceMap surfaces(config_.surface_voxel_size_m);
  for (const KeyScan& key_scan : key_scans_) {
    surfaces.Insert(Transform(PoseOf(key_scan), key_scan.point_in_base));
  }
  surfaces.FitPlanes();
  return surfaces;
}

// Between two surveyed poses the robot moves as its odometry says, and what is left at the second
// is spread over the way in time.
absl::Status Mapper::Drive::ApplySurveyedPoses() {
  std::vector<bool> placed(path_.size(), false);
  for (std::size_t i = 0; i < path_.size(); ++i) {
    PathEntry& entry = path_[i];
    const auto after = std::lower_bound(
        surveyed_.begin(), surveyed_.end(), entry.stamp_ns,
        [](const SurveyedPose& pose, TimeNs stamp_ns) { return pose.pose.stamp_ns < stamp_ns; });
    if (after == surveyed_.end()) continue;
    if (after->pose.stamp_ns == entry.stamp_ns) {
      entry.map_from_base = after->pose.map_from_base;
      placed[i] = true;
      continue;
    }
    if (after == surveyed_.begin()) continue;
    const SurveyedPose& begin = *std::prev(after);
    const SurveyedPose& end = *after;
    const double fraction = static_cast<double>(entry.stamp_ns - begin.pose.stamp_ns) /
                            static_cast<double>(end.pose.stamp_ns - begin.pose.stamp_ns);
    if (begin.odom_from_base && end.odom_from_base) {
      const Pose2 map_from_odom = begin.pose.map_from_base * begin.odom_from_base->Inverse();
      const Pose2 left = (map_from_odom * *end.odom_from_base).Inverse() * end.pose.map_from_base;
      entry.map_from_base =
          map_from_odom * entry.odom_from_base * geometry::Interpolate(Pose2{}, left, fraction);
    } else {
      entry.map_from_base =
          geometry::Interpolate(begin.pose.map_from_base, end.pose.map_from_base, fraction);
    }
    placed[i] = true;
  }

  std::vector<PathEntry> kept_path;
  std::vector<KeyScan> kept_scans;
  std::vector<std::size_t> new_index(path_.size());
  for (std::size_t i = 0; i < path_.size(); ++i) {
    if (!placed[i]) {
      ++report_.scans_dropped;
      continue;
    }
    new_index[i] = kept_path.size();
    kept_path.push_back(path_[i]);
  }
  for (KeyScan& key_scan : key_scans_) {
    if (!placed[key_scan.path_index]) continue;
    key_scan.path_index = new_index[key_scan.path_index];
    kept_scans.push_back(std::move(key_scan));
  }
  path_ = std::move(kept_path);
  key_scans_ = std::move(kept_scans);
  if (key_scans_.empty()) {
    return absl::InvalidArgumentError(
        "no LIDAR scan of the mapping drive lies between two of the surveyed poses");
  }
  return absl::OkStatus();
}

// Aligns every key scan to the map of all of them, with the first as the anchor; then the scans
// between follow theirs.
absl::Status Mapper::Drive::Relax(const Progress& progress) {
  const absl::Status cancelled = absl::CancelledError("the mapping was cancelled");
  const std::vector<PathEntry> before = path_;
  for (int pass = 0; pass < config_.relaxation_passes; ++pass) {
    const SurfaceMap surfaces = MapOfKeyScans();
    std::vector<Pose2> aligned;
    double residual_sum_m = 0.0;
    for (const KeyScan& key_scan : key_scans_) {
      const SearchRange range{.start_distance_m = config_.surface_voxel_size_m,
                              .prior_std_m = kPriorMin_m,
                              .prior_std_rad = kPriorMin_rad};
      const Registration registration =
          Register(PointsToAlign(key_scan.point_in_base), surfaces, PoseOf(key_scan), range);
      aligned.push_back(registration.map_from_base);
      residual_sum_m += registration.mean_residual_m;
      const double done = (pass + static_cast<double>(aligned.size()) / key_scans_.size()) /
                          config_.relaxation_passes;
      if (progress && !progress(0.5 * done)) return cancelled;
    }
    report_.mean_residual_m = residual_sum_m / static_cast<double>(key_scans_.size());
    const Pose2 anchored_from_aligned = PoseOf(key_scans_.front()) * aligned.front().Inverse();
    for (std::size_t i = 0; i < key_scans_.size(); ++i) {
      PoseOf(key_scans_[i]) = anchored_from_aligned * aligned[i];
    }
  }
  for (std::size_t i = 0; i < path_.size(); ++i) {
    if (!path_[i].key_scan) continue;
    const std::size_t key_index = key_scans_[*path_[i].key_scan].path_index;
    if (key_index == i) continue;
    path_[i].map_from_base = path_[key_index].map_from_base *
                             before[key_index].map_from_base.Inverse() * before[i].map_from_base;
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<octomap::OcTree>> Mapper::Drive::CastRays(
    const Progress& progress) const {
  const SurfaceMap surfaces = MapOfKeyScans();
  OccupancyGrid grid(config_.voxel_size_m, config_.occupancy);
  std::vector<Ray> rays;
  for (std::size_t i = 0; i < key_scans_.size(); ++i) {
    const KeyScan& key_scan = key_scans_[i];
    const std::vector<Eigen::Vector3f> ends = Transform(PoseOf(key_scan), key_scan.point_in_base);
    const std::vector<Eigen::Vector3f> origins =
        Transform(PoseOf(key_scan), key_scan.lidar_in_base);
    rays.clear();
    for (std::size_t p = 0; p < ends.size(); ++p) {
      Ray ray{origins[key_scan.part[p]], ends[p], static_cast<float>(config_.voxel_size_m)};
      const Surfel* surfel = surfaces.At(ray.end_in_map);
      if (surfel && surfel->has_plane()) {
        const Eigen::Vector3f direction = (ray.end_in_map - ray.origin_in_map).normalized();
        ray.margin_m = static_cast<float>(
            std::min(config_.voxel_size_m / std::abs(surfel->normal.dot(direction)), kMaxMargin_m));
      }
      rays.push_back(ray);
    }
    if (const absl::Status status = grid.InsertScan(rays); !status.ok()) return status;
    const double done = static_cast<double>(i + 1) / key_scans_.size();
    if (progress && !progress(0.5 + 0.4 * done)) {
      return absl::CancelledError("the mapping was cancelled");
    }
  }
  return grid.ToOctree();
}

absl::StatusOr<building::FloorPlan> Mapper::Drive::Slice(const octomap::OcTree& octree) const {
  const double laser_height_m = calibration_.base_from_laser.translation().z();
  const double height_m = config_.slice_height_m.value_or(
      laser_height_m >= kMinLaserHeight_m ? laser_height_m : config_.slice_height_without_lrf_m);
  return building::SliceFloorPlan(octree, height_m - config_.slice_half_thickness_m,
                                  height_m + config_.slice_half_thickness_m);
}

absl::Status Mapper::Drive::NothingToMap() const {
  if (report_.scans == 0) {
    return absl::InvalidArgumentError("the mapping drive has no LIDAR scans");
  }
  if (!first_odom_from_base_) {
    return absl::InvalidArgumentError("the mapping drive has no odometry");
  }
  if (scans_without_points_ == report_.scans) {
    return absl::InvalidArgumentError(absl::StrCat(
        "none of the mapping drive's ", report_.scans, " LIDAR scans has a point from ",
        config_.min_range_m, " to ", config_.max_range_m, " m"));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("none of the mapping drive's ", report_.scans, " LIDAR scans could be used; ",
                   scans_without_odometry_, " were taken at a time without odometry"));
}

absl::StatusOr<MappingResult> Mapper::Drive::Finish(const Progress& progress) {
  if (finished_) return absl::FailedPreconditionError("the mapping is finished already");
  finished_ = true;
  ProcessWaiting(/*all=*/true);
  if (key_scans_.empty()) return NothingToMap();

  const absl::Status placed = surveyed_.empty() ? Relax(progress) : ApplySurveyedPoses();
  if (!placed.ok()) return placed;
  auto octree = CastRays(progress);
  if (!octree.ok()) return octree.status();
  auto floor_plan = Slice(**octree);
  if (!floor_plan.ok()) return floor_plan.status();
  if (progress && !progress(1.0)) return absl::CancelledError("the mapping was cancelled");

  MappingResult result{{*std::move(octree), *std::move(floor_plan)}, report_};
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

absl::StatusOr<Mapper> Mapper::Create(const MapperConfig& config,
                                      const frames::Calibration& calibration,
                                      const Pose2& map_from_base,
                                      std::vector<StampedPose> surveyed) {
  for (const absl::Status& status : {config.Validate(), calibration.Validate()}) {
    if (!status.ok()) return status;
  }
  if (!IsFinite(map_from_base)) {
    return absl::InvalidArgumentError("the mapping drive's initial pose is not finite");
  }
  if (surveyed.size() == 1) {
    return absl::InvalidArgumentError("one surveyed pose does not place a drive; two or more do");
  }
  for (std::size_t i = 0; i < surveyed.size(); ++i) {
    if (!IsFinite(surveyed[i].map_from_base) || surveyed[i].stamp_ns < 0 ||
        surveyed[i].stamp_ns > kMaxStamp_ns) {
      return absl::InvalidArgumentError(
          absl::StrCat("the surveyed pose ", i, " is not finite or its time is out of range"));
    }
    if (i > 0 && surveyed[i].stamp_ns <= surveyed[i - 1].stamp_ns) {
      return absl::InvalidArgumentError(
          absl::StrCat("the surveyed pose ", i, " is not later than the one before"));
    }
  }
  return Mapper(std::make_unique<Drive>(config, calibration, map_from_base, std::move(surveyed)));
}

Mapper::Mapper(std::unique_ptr<Drive> drive) : drive_(std::move(drive)) {}
Mapper::Mapper(Mapper&&) noexcept = default;
Mapper& Mapper::operator=(Mapper&&) noexcept = default;
Mapper::~Mapper() = default;

absl::Status Mapper::Add(const frames::Frame& frame) {
  if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) return drive_->Add(*odometry);
  if (const auto* scan = std::get_if<frames::LidarScan>(&frame)) return drive_->Add(*scan);
  return absl::OkStatus();
}

absl::StatusOr<MappingResult> Mapper::Finish(const std::function<bool(double)>& progress) {
  return drive_->Finish(progress);
}

}  // namespace soundmap::mapping
