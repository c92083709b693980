#include "mapping/floor_plan_mapper.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "frames/odometry_track.h"
#include "geometry/angles.h"
#include "mapping/laser_drive_placement.h"
#include "mapping/laser_front_end.h"
#include "mapping/laser_loops.h"
#include "mapping/laser_plan.h"
#include "mapping/laser_relaxation.h"
#include "mapping/planar_poses.h"
#include "mapping/surveyed_poses.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;
using Progress = std::function<bool(double)>;

constexpr double kMaxTilt_rad = 0.175;

// How far off a drive may be placed, and the way that lets the search for loops look as far.
constexpr double kPlacedStd_m = 0.3;
constexpr double kPlacedStd_rad = 0.03;
constexpr double kPlacedWay_m = 10.0;

// Shares of the progress: drives alone and their places (of several), loops, relaxation, rays.
constexpr double kPlaced = 0.3, kClosed = 0.6, kRelaxed = 0.8;

Progress Part(const Progress& progress, double begin, double end) {
  return [&progress, begin, end](double done) {
    return !progress || progress(begin + (end - begin) * done);
  };
}

absl::Status CheckDrive(const frames::Calibration& calibration,
                        const std::optional<Pose2>& map_from_base) {
  if (const absl::Status status = calibration.Validate(); !status.ok()) return status;
  if (map_from_base && !IsFinite(*map_from_base)) {
    return absl::InvalidArgumentError("the mapping drive's initial pose is not finite");
  }
  const double upright = std::abs(calibration.base_from_laser.linear()(2, 2));
  if (!(upright >= std::cos(kMaxTilt_rad))) {
    return absl::InvalidArgumentError(
        absl::StrCat("the LRF is tilted by ",
                     std::lround(geometry::DegFromRad(std::acos(std::min(upright, 1.0)))),
                     " degrees; a floor plan needs it level within 10"));
  }
  return absl::OkStatus();
}

}  // namespace

class FloorPlanMapper::Work {
 public:
  Work(const FloorPlanMapperConfig& config, SurveyedPoses surveyed,
       std::shared_ptr<const building::Building> extend)
      : config_(config), surveyed_(std::move(surveyed)), extend_(std::move(extend)) {
    if (extend_) walls_ = WallPoints(extend_->floor_plan);
  }

  absl::Status BeginDrive(const frames::Calibration& calibration,
                          const std::optional<Pose2>& map_from_base) {
    if (!surveyed_.empty() && !drives_.empty()) {
      return absl::InvalidArgumentError("surveyed poses place one mapping drive, not several");
    }
    if (const absl::Status status = CheckDrive(calibration, map_from_base); !status.ok()) {
      return status;
    }
    drives_.push_back(std::make_unique<Drive>(
        Drive{LaserFrontEnd(config_, calibration, map_from_base.value_or(Pose2{})),
              map_from_base.has_value()}));
    return absl::OkStatus();
  }
  LaserFrontEnd& front_end() { return drives_.back()->front_end; }
  absl::StatusOr<FloorPlanResult> Finish(const Progress& progress);

 private:
  struct Drive {
    LaserFrontEnd front_end;
    bool start_is_known = false;
    std::vector<Pose2> as_driven;   // of the key scans
    std::vector<Pose2> on_its_own;  // the same, the drive's loops closed
    std::optional<Pose2> map_from_drive;
  };

  absl::Status ApplySurveyedPoses(Drive& drive);
  absl::Status CloseLoopsAndRelax(const Progress& progress);
  absl::Status PlaceDrives(const Progress& progress);
  std::vector<LaserKeyScan> TakeKeyScans();
  FloorPlanReport Report();

  const FloorPlanMapperConfig config_;
  SurveyedPoses surveyed_;
  std::shared_ptr<const building::Building> extend_;
  std::vector<Eigen::Vector2f> walls_;  // of `extend_`
  std::vector<std::unique_ptr<Drive>> drives_;
  int outside_survey_ = 0;
  LoopReport loops_;
  double mean_residual_m_ = 0.0;
  bool finished_ = false;
};

absl::Status FloorPlanMapper::Work::ApplySurveyedPoses(Drive& drive) {
  frames::OdometryTrack registered(1e9);  // better than the odometry
  for (const LaserPathEntry& entry : drive.front_end.path()) {
    registered.Add({entry.stamp_ns, entry.map_from_base});
  }
  surveyed_.Follow(registered);
  std::vector<LaserPathEntry> path;
  std::vector<LaserKeyScan> key_scans;
  std::vector<LaserKeyScan>& all = drive.front_end.key_scans();
  std::size_t next_key_scan = 0;
  for (std::size_t i = 0; i < drive.front_end.path().size(); ++i) {
    const LaserPathEntry& entry = drive.front_end.path()[i];
    const bool is_key_scan = next_key_scan < all.size() && all[next_key_scan].path_index == i;
    const std::size_t key_scan = is_key_scan ? next_key_scan++ : 0;
    const auto placed = surveyed_.At(entry.stamp_ns, entry.map_from_base);
    if (!placed) {
      ++outside_survey_;
      continue;
    }
    if (is_key_scan) {
      all[key_scan].path_index = path.size();
      all[key_scan].map_from_base = *placed;
      key_scans.push_back(std::move(all[key_scan]));
    }
    path.push_back(entry);
    path.back().map_from_base = *placed;
  }
  drive.front_end.path() = std::move(path);
  all = std::move(key_scans);
  if (all.empty()) {
    return absl::InvalidArgumentError(
        "no LRF scan of the mapping drive lies between two of the surveyed poses");
  }
  return absl::OkStatus();
}

// Closes the loops of each drive by itself, and finds where it lies in the map that is extended, or
// in the first drive and those that are placed by then.
absl::Status FloorPlanMapper::Work::PlaceDrives(const Progress& progress) {
  const double share = 0.5 / static_cast<double>(drives_.size());
  for (std::size_t i = 0; i < drives_.size(); ++i) {
    const double begin = static_cast<double>(i) * share;
    std::vector<LaserKeyScan>& key_scans = drives_[i]->front_end.key_scans();
    for (const LaserKeyScan& scan : key_scans) drives_[i]->as_driven.push_back(scan.map_from_base);
    LoopReport loops;
    double residual_m = 0.0;
    absl::Status status =
        CloseLoops(config_, Part(progress, begin, begin + 0.7 * share), key_scans, loops);
    if (status.ok()) {
      status = RelaxLaserScans(config_, {}, Part(progress, begin + 0.7 * share, begin + share),
                               key_scans, residual_m);
    }
    if (!status.ok()) return status;
    for (const LaserKeyScan& scan : key_scans) drives_[i]->on_its_own.push_back(scan.map_from_base);
  }
  std::optional<building::FloorPlan> plan;
  if (extend_) plan = extend_->floor_plan;
  const auto place = [this, &plan](Drive& drive, const Pose2& map_from_drive) -> absl::Status {
    drive.map_from_drive = map_from_drive;
    std::vector<LaserKeyScan>& key_scans = drive.front_end.key_scans();
    for (LaserKeyScan& scan : key_scans) scan.map_from_base = map_from_drive * scan.map_from_base;
    auto drawn = DrawFloorPlan(config_, key_scans, plan ? &*plan : nullptr, {});
    if (drawn.ok()) plan = *std::move(drawn);
    return drawn.status();
  };
  if (!extend_) {
    if (const absl::Status status = place(*drives_.front(), Pose2{}); !status.ok()) return status;
  }
  int missing = 0;
  for (bool advanced = true; advanced;) {
    advanced = false;
    missing = 0;
    for (std::size_t i = 0; i < drives_.size(); ++i) {
      Drive& drive = *drives_[i];
      if (drive.map_from_drive) continue;
      if (progress && !progress(0.5 + share * static_cast<double>(i))) {
        return absl::CancelledError("the mapping was cancelled");
      }
      const auto found = PlaceLaserDrive(drive.front_end.key_scans(), *plan, config_.wall_piece_m,
                                         drive.start_is_known);
      if (found) {
        if (const absl::Status status = place(drive, *found); !status.ok()) return status;
        advanced = true;
      } else if (missing == 0) {
        missing = static_cast<int>(i) + 1;
      }
    }
  }
  if (missing == 0) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("the mapping drive ", missing, " does not overlap ",
                   extend_ ? "the map that it is to extend" : "the map of the drives before",
                   ", or could lie at several places of it"));
}

// Of all drives in their order, after the walls that are extended.
std::vector<LaserKeyScan> FloorPlanMapper::Work::TakeKeyScans() {
  std::vector<LaserKeyScan> all;
  if (extend_) {
    LaserKeyScan map;
    map.points.point_in_base = walls_;
    map.is_map = true;
    all.push_back(std::move(map));
  }
  for (const auto& drive : drives_) {
    std::vector<LaserKeyScan>& key_scans = drive->front_end.key_scans();
    const double way_m = all.empty() ? 0.0 : all.back().way_m + kPlacedWay_m;
    for (std::size_t i = 0; i < key_scans.size(); ++i) {
      LaserKeyScan& scan = key_scans[i];
      scan.way_m += way_m;
      if (drive->map_from_drive) {
        // As driven, from where it began.
        scan.map_from_base = *drive->map_from_drive * drive->on_its_own.front() *
                             drive->as_driven.front().Inverse() * drive->as_driven[i];
      }
      if (i == 0 && !all.empty()) {
        scan.begins_drive = true;
        scan.step_covariance =
            Eigen::Vector3d(kPlacedStd_m * kPlacedStd_m, kPlacedStd_m * kPlacedStd_m,
                            kPlacedStd_rad * kPlacedStd_rad)
                .asDiagonal();
      }
      all.push_back(std::move(scan));
    }
  }
  return all;
}

absl::Status FloorPlanMapper::Work::CloseLoopsAndRelax(const Progress& progress) {
  const bool is_alone = drives_.size() == 1 && !extend_;
  if (!is_alone) {
    if (absl::Status status = PlaceDrives(Part(progress, 0.0, kPlaced)); !status.ok()) {
      return status;
    }
  }
  std::vector<LaserKeyScan> key_scans = TakeKeyScans();
  absl::Status status =
      CloseLoops(config_, Part(progress, is_alone ? 0.0 : kPlaced, kClosed), key_scans, loops_);
  if (extend_) key_scans.erase(key_scans.begin());
  if (status.ok()) {
    status = RelaxLaserScans(config_, walls_, Part(progress, kClosed, kRelaxed), key_scans,
                             mean_residual_m_);
  }
  if (!status.ok()) return status;
  auto next = key_scans.begin();
  for (const auto& drive : drives_) {
    std::vector<LaserKeyScan>& own = drive->front_end.key_scans();
    std::move(next, next + static_cast<std::ptrdiff_t>(own.size()), own.begin());
    next += static_cast<std::ptrdiff_t>(own.size());
    PlacePath(own, drive->front_end.path());
  }
  return absl::OkStatus();
}

FloorPlanReport FloorPlanMapper::Work::Report() {
  FloorPlanReport report;
  report.scans_dropped = outside_survey_;
  report.loops_closed = loops_.loops_closed;
  report.loops_refused = loops_.loops_refused;
  report.laser_lag_s = drives_.front()->front_end.laser_lag_s();
  report.mean_residual_m = mean_residual_m_;
  for (const auto& drive : drives_) {
    LaserFrontEnd& front_end = drive->front_end;
    report.scans += front_end.report().scans;
    report.scans_dropped += front_end.report().scans_dropped;
    report.scans_unregistered += front_end.report().scans_unregistered;
    report.key_scans += static_cast<int>(front_end.key_scans().size());
    report.drive_begin.push_back(report.path.size());
    const std::vector<LaserPathEntry>& path = front_end.path();
    for (const LaserPathEntry& entry : path) {
      report.path.push_back({entry.stamp_ns, entry.map_from_base});
    }
    const Pose2 end_by_odometry = path.front().map_from_base *
                                  path.front().odom_from_base.Inverse() *
                                  path.back().odom_from_base;
    const Pose2 off = end_by_odometry.Inverse() * path.back().map_from_base;
    report.drift_removed_m = std::max(report.drift_removed_m, std::hypot(off.x_m, off.y_m));
  }
  return report;
}

absl::StatusOr<FloorPlanResult> FloorPlanMapper::Work::Finish(const Progress& progress) {
  if (finished_) return absl::FailedPreconditionError("the mapping is finished already");
  finished_ = true;
  for (std::size_t i = 0; i < drives_.size(); ++i) {
    LaserFrontEnd& front_end = drives_[i]->front_end;
    front_end.Finish();
    if (!front_end.key_scans().empty()) continue;
    const absl::Status nothing = front_end.NothingToMap();
    if (drives_.size() == 1) return nothing;
    return absl::InvalidArgumentError(
        absl::StrCat("mapping drive ", i + 1, ": ", std::string(nothing.message())));
  }
  const absl::Status placed =
      surveyed_.empty() ? CloseLoopsAndRelax(progress) : ApplySurveyedPoses(*drives_.front());
  if (!placed.ok()) return placed;
  FloorPlanReport report = Report();
  std::vector<LaserKeyScan> key_scans;
  for (const auto& drive : drives_) {
    for (LaserKeyScan& scan : drive->front_end.key_scans()) key_scans.push_back(std::move(scan));
  }
  auto floor_plan = DrawFloorPlan(config_, key_scans, extend_ ? &extend_->floor_plan : nullptr,
                                  Part(progress, kRelaxed, 1.0));
  if (!floor_plan.ok()) return floor_plan.status();
  return FloorPlanResult{{extend_ ? extend_->octree : nullptr, *std::move(floor_plan)},
                         std::move(report)};
}

absl::StatusOr<FloorPlanMapper> FloorPlanMapper::Create(
    const FloorPlanMapperConfig& config, const frames::Calibration& calibration,
    const Pose2& map_from_base, std::vector<StampedPose> surveyed,
    std::shared_ptr<const building::Building> extend) {
  if (const absl::Status status = config.Validate(); !status.ok()) return status;
  if (extend && !surveyed.empty()) {
    return absl::InvalidArgumentError(
        "a map is extended either by registration or by surveyed poses, not by both");
  }
  auto poses = SurveyedPoses::Create(std::move(surveyed));
  if (!poses.ok()) return poses.status();
  auto work = std::make_unique<Work>(config, *std::move(poses), std::move(extend));
  const absl::Status begun = work->BeginDrive(calibration, map_from_base);
  if (!begun.ok()) return begun;
  return FloorPlanMapper(std::move(work));
}

FloorPlanMapper::FloorPlanMapper(std::unique_ptr<Work> work) : work_(std::move(work)) {}
FloorPlanMapper::FloorPlanMapper(FloorPlanMapper&&) noexcept = default;
FloorPlanMapper& FloorPlanMapper::operator=(FloorPlanMapper&&) noexcept = default;
FloorPlanMapper::~FloorPlanMapper() = default;

absl::Status FloorPlanMapper::Add(const frames::Frame& frame) {
  if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) {
    return work_->front_end().Add(*odometry);
  }
  if (const auto* scan = std::get_if<frames::LaserScan>(&frame)) {
    return work_->front_end().Add(*scan);
  }
  return absl::OkStatus();
}

absl::Status FloorPlanMapper::BeginDrive(const frames::Calibration& calibration,
                                         std::optional<Pose2> map_from_base) {
  return work_->BeginDrive(calibration, map_from_base);
}

absl::StatusOr<FloorPlanResult> FloorPlanMapper::Finish(
    const std::function<bool(double)>& progress) {
  return work_->Finish(progress);
}

}  // namespace soundmap::mapping
