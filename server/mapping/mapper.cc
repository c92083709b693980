#include "mapping/mapper.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "absl/strings/str_cat.h"
#include "mapping/building_from_scans.h"
#include "mapping/drive_placement.h"
#include "mapping/drive_registration.h"
#include "mapping/loop_closing.h"
#include "mapping/odometry_scale.h"
#include "mapping/planar_poses.h"
#include "mapping/surveyed_poses.h"

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;
using geometry::Pose2;

// Levels of the surfaces among which a drive is placed.
constexpr int kLevels = 3;
// Between drives, loops are looked for after so much way.
constexpr double kLoopInterval_m = 1.0;

// Parts of the work that remains after the last frame.
constexpr double kPlaced = 0.2;
constexpr double kRelaxed = 0.6;
constexpr double kCast = 0.95;

absl::Status Cancelled() { return absl::CancelledError("the mapping was cancelled"); }

ScanPreparationConfig PreparationOf(const MapperConfig& config) {
  return {
      config.min_range_m, config.max_range_m, {config.max_speed_mps, config.max_turn_rate_radps}};
}

DriveRegistrationConfig RegistrationOf(const MapperConfig& config, bool align) {
  return {config.voxel_size_m,       config.surface_voxel_size_m, config.key_scan_distance_m,
          config.key_scan_angle_rad, config.key_scans_per_place,  align};
}

// One drive: its frames, and what has become of them.
struct Drive {
  Drive(const MapperConfig& config, const frames::Calibration& robot, const Pose2& map_from_base,
        bool near, bool align)
      : calibration(robot),
        start_is_known(near),
        preparation(PreparationOf(config), robot),
        registration(RegistrationOf(config, align), map_from_base) {}

  void Process(bool end) {
    while (const auto scan = preparation.Next(end)) registration.Add(*scan, preparation);
  }

  frames::Calibration calibration;
  bool start_is_known;
  ScanPreparation preparation;
  DriveRegistration registration;
  std::optional<int> first_scan;  // in the graph of all drives, once the drive is placed
};

}  // namespace

class Mapper::Work {
 public:
  Work(const MapperConfig& config, const frames::Calibration& calibration,
       const Pose2& map_from_base, SurveyedPoses surveyed,
       std::shared_ptr<const building::Building> extend)
      : config_(config),
        start_map_from_base_(map_from_base),
        surveyed_(std::move(surveyed)),
        extend_(std::move(extend)) {
    drives_.push_back(std::make_unique<Drive>(config_, calibration, map_from_base, /*near=*/true,
                                              /*align=*/surveyed_.empty()));
  }

  absl::Status Add(const frames::Frame& frame);
  absl::Status BeginDrive(const frames::Calibration& calibration,
                          std::optional<Pose2> map_from_base);
  absl::StatusOr<MappingResult> Finish(const ProgressFn& progress);

 private:
  absl::Status NothingToMap(std::size_t drive) const;
  absl::Status ApplySurveyedPoses();
  absl::Status PlaceDrives(const ProgressFn& progress);
  bool Place(Drive& drive, const SurfacePyramid& surfaces);
  void Join(Drive& drive, const Placement& placement);
  void CloseLoopsBetweenDrives(int first_scan);
  void ReturnToStart();
  absl::StatusOr<building::FloorPlan> Slice(const octomap::OcTree& octree) const;
  Isometry3d PoseOf(const Drive& drive, const PathEntry& entry) const {
    return graph_.scans[*drive.first_scan + entry.scan].map_from_base * entry.scan_from_base;
  }
  void Report(MappingReport& report) const;

  const MapperConfig config_;
  const Pose2 start_map_from_base_;  // of the first drive
  SurveyedPoses surveyed_;           // of the first drive
  std::shared_ptr<const building::Building> extend_;
  std::vector<Eigen::Vector3f> building_surface_;  // of `extend_`
  std::vector<std::unique_ptr<Drive>> drives_;
  KeyScanGraph graph_;  // of the drives that are placed
  LoopCount loops_;
  int outside_survey_ = 0;
  double mean_residual_m_ = 0.0;
  bool finished_ = false;
};

absl::Status Mapper::Work::Add(const frames::Frame& frame) {
  if (finished_) return absl::FailedPreconditionError("the mapping is finished already");
  Drive& drive = *drives_.back();
  absl::Status status;
  if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) {
    status = drive.preparation.Add(*odometry);
    if (drives_.size() == 1 && !surveyed_.empty()) surveyed_.Follow(drive.preparation.track());
  } else if (const auto* scan = std::get_if<frames::LidarScan>(&frame)) {
    status = drive.preparation.Add(*scan);
  } else if (const auto* scan = std::get_if<frames::LaserScan>(&frame)) {
    status = drive.preparation.Add(*scan);
  } else {
    return status;
  }
  drive.Process(/*end=*/false);
  return status;
}

absl::Status Mapper::Work::BeginDrive(const frames::Calibration& calibration,
                                      std::optional<Pose2> map_from_base) {
  if (finished_) return absl::FailedPreconditionError("the mapping is finished already");
  if (const absl::Status status = calibration.Validate(); !status.ok()) return status;
  if (map_from_base && !IsFinite(*map_from_base)) {
    return absl::InvalidArgumentError("the mapping drive's initial pose is not finite");
  }
  drives_.back()->Process(/*end=*/true);
  drives_.push_back(std::make_unique<Drive>(config_, calibration, map_from_base.value_or(Pose2{}),
                                            map_from_base.has_value(), /*align=*/true));
  return absl::OkStatus();
}

absl::Status Mapper::Work::NothingToMap(std::size_t index) const {
  const ScanPreparation& preparation = drives_[index]->preparation;
  const std::string name =
      drives_.size() == 1 ? "the mapping drive" : absl::StrCat("the mapping drive ", index + 1);
  if (preparation.scans() == 0) {
    return absl::InvalidArgumentError(absl::StrCat(name, " has no LIDAR scans"));
  }
  if (!preparation.first_odom_from_base()) {
    return absl::InvalidArgumentError(absl::StrCat(name, " has no odometry"));
  }
  if (preparation.without_points() == preparation.scans()) {
    return absl::InvalidArgumentError(absl::StrCat(
        name, " has ", preparation.scans(), " LIDAR scans, none of which has a point from ",
        config_.min_range_m, " to ", config_.max_range_m, " m"));
  }
  return absl::InvalidArgumentError(absl::StrCat(
      name, " has ", preparation.scans(), " LIDAR scans, none of which could be used; ",
      preparation.without_odometry(), " were taken at a time without odometry"));
}

// Key scans and path of the first drive go where the survey says; what lies outside is dropped.
absl::Status Mapper::Work::ApplySurveyedPoses() {
  DriveRegistration& drive = drives_.front()->registration;
  std::vector<PathEntry> path;
  KeyScanGraph graph;
  std::vector<int> new_scan(drive.graph.scans.size(), -1);
  for (const PathEntry& entry : drive.path) {
    const auto map_from_base = surveyed_.At(entry.stamp_ns, entry.odom_from_base);
    if (!map_from_base) {
      ++outside_survey_;
      continue;
    }
    PathEntry placed = entry;
    const bool is_key_scan =
        new_scan[entry.scan] < 0 && entry.scan_from_base.matrix().isIdentity(1e-9);
    if (is_key_scan) {
      new_scan[entry.scan] = static_cast<int>(graph.scans.size());
      graph.scans.push_back(std::move(drive.graph.scans[entry.scan]));
      graph.scans.back().map_from_base = map_from_base->ToIsometry();
      graph.scans.back().fixed = true;
    }
    // Before the first key scan there is none to move with.
    placed.scan = std::max(new_scan[entry.scan], 0);
    placed.scan_from_base = map_from_base->ToIsometry();
    path.push_back(placed);
  }
  if (graph.scans.empty()) {
    return absl::InvalidArgumentError(
        "no LIDAR scan of the mapping drive lies between two of the surveyed poses");
  }
  for (PathEntry& entry : path) {
    entry.scan_from_base = graph.scans[entry.scan].map_from_base.inverse() * entry.scan_from_base;
  }
  drive.graph = std::move(graph);
  drive.path = std::move(path);
  return absl::OkStatus();
}

void Mapper::Work::Join(Drive& drive, const Placement& placement) {
  const int first = static_cast<int>(graph_.scans.size());
  drive.first_scan = first;
  for (KeyScan& scan : drive.registration.graph.scans) scan.fixed = scan.fixed && first == 0;
  graph_.Append(std::move(drive.registration.graph), placement.map_from_drive);
  for (const Placement::Scan& verified : placement.verified) {
    const int to = first + verified.scan;
    // To the nearest scan before, or to the building that is extended.
    int from = kBuilding;
    double nearest_m = 0.0;
    for (int i = 0; i < first; ++i) {
      const double distance_m = (graph_.scans[i].map_from_base.translation() -
                                 verified.registration.map_from_base.translation())
                                    .norm();
      if (from != kBuilding && distance_m >= nearest_m) continue;
      from = i;
      nearest_m = distance_m;
    }
    const Isometry3d map_from_from =
        from == kBuilding ? Isometry3d::Identity() : graph_.scans[from].map_from_base;
    const Isometry3d between = map_from_from.inverse() * verified.registration.map_from_base;
    graph_.edges.push_back({from, to, between,
                            EdgeInformation(Isometry3d::Identity(),
                                            verified.registration.information, EdgeKind::kLoop),
                            /*loop=*/true});
  }
}

bool Mapper::Work::Place(Drive& drive, const SurfacePyramid& surfaces) {
  const auto placement = PlaceDrive(drive.registration.graph, surfaces, drive.start_is_known);
  if (!placement) return false;
  const int first = static_cast<int>(graph_.scans.size());
  Join(drive, *placement);
  graph_.Optimize().IgnoreError();  // as placed, if it cannot be solved
  CloseLoopsBetweenDrives(first);
  return true;
}

void Mapper::Work::CloseLoopsBetweenDrives(int first_scan) {
  double way_m = kLoopInterval_m;
  for (int scan = first_scan; scan < static_cast<int>(graph_.scans.size()); ++scan) {
    if (scan > first_scan) way_m += graph_.Between(scan - 1, scan).translation().norm();
    if (way_m < kLoopInterval_m) continue;
    way_m = 0.0;
    CloseLoop(graph_, scan, config_.surface_voxel_size_m, loops_);
  }
}

// The first drive makes the frame, or is placed in the building that is extended; the others are
// placed as soon as what is placed reaches them.
absl::Status Mapper::Work::PlaceDrives(const ProgressFn& progress) {
  if (!extend_) {
    Join(*drives_.front(), {});
  } else if (extend_->octree) {
    building_surface_ = SurfacePoints(*extend_->octree);
  }
  const auto placed = [](const std::unique_ptr<Drive>& drive) {
    return drive->first_scan.has_value();
  };
  for (bool advanced = true; advanced;) {
    advanced = false;
    for (std::size_t i = 0; i < drives_.size(); ++i) {
      if (placed(drives_[i])) continue;
      if (progress && !progress(static_cast<double>(i) / static_cast<double>(drives_.size()))) {
        return Cancelled();
      }
      const SurfacePyramid surfaces =
          AllSurfaces(graph_.scans, building_surface_, config_.surface_voxel_size_m, kLevels);
      advanced = Place(*drives_[i], surfaces) || advanced;
    }
  }
  const auto missing = std::find_if_not(drives_.begin(), drives_.end(), placed);
  if (missing == drives_.end()) return absl::OkStatus();
  const auto number = missing - drives_.begin() + 1;
  return absl::FailedPreconditionError(
      absl::StrCat("the mapping drive ", number, " does not overlap ",
                   extend_ ? "the map that it is to extend" : "the map of the drives before",
                   ", or could lie at several places of it"));
}

// Between the start, which makes the frame, and the first scan there is odometry alone, and what it
// turns wrong there turns the whole map. By now the drive tells how wrong that is.
void Mapper::Work::ReturnToStart() {
  const Drive& drive = *drives_.front();
  const std::vector<PathEntry>& path = drive.registration.path;
  std::vector<MappedOdometry> mapped;
  mapped.reserve(path.size());
  for (const PathEntry& entry : path) {
    mapped.push_back({entry.odom_from_base, geometry::ProjectToFloor(PoseOf(drive, entry))});
  }
  const Pose2 start_from_first = ScaleOf(mapped).Corrected(
      drive.preparation.first_odom_from_base()->Inverse() * path.front().odom_from_base);
  const Isometry3d map_from_mapped =
      (start_map_from_base_ * start_from_first * mapped.front().map_from_base.Inverse())
          .ToIsometry();
  for (KeyScan& scan : graph_.scans) scan.map_from_base = map_from_mapped * scan.map_from_base;
}

absl::StatusOr<building::FloorPlan> Mapper::Work::Slice(const octomap::OcTree& octree) const {
  const double laser_height_m = drives_.front()->calibration.base_from_laser.translation().z();
  const double height_m = config_.slice_height_m.value_or(
      laser_height_m >= kMinLaserHeight_m ? laser_height_m : config_.slice_height_without_lrf_m);
  return building::SliceFloorPlan(octree, height_m - config_.slice_half_thickness_m,
                                  height_m + config_.slice_half_thickness_m);
}

void Mapper::Work::Report(MappingReport& report) const {
  report.key_scans = static_cast<int>(graph_.scans.size());
  report.mean_residual_m = mean_residual_m_;
  report.scans_dropped = outside_survey_;
  report.loops_tried = loops_.tried;
  report.loops_closed = loops_.closed;
  report.loops_refused = loops_.refused;
  for (const auto& drive : drives_) {
    const DriveRegistration& registration = drive->registration;
    report.scans += drive->preparation.scans();
    report.scans_dropped += drive->preparation.dropped();
    report.scans_unregistered += registration.unregistered;
    report.loops_tried += registration.loops.tried;
    report.loops_closed += registration.loops.closed;
    report.loops_refused += registration.loops.refused;
    report.drive_begin.push_back(report.path.size());
    for (const PathEntry& entry : registration.path) {
      report.path.push_back({entry.stamp_ns, geometry::ProjectToFloor(PoseOf(*drive, entry))});
    }
    const PathEntry& first = registration.path.front();
    const PathEntry& last = registration.path.back();
    const Pose2 by_odometry = geometry::ProjectToFloor(PoseOf(*drive, first)) *
                              first.odom_from_base.Inverse() * last.odom_from_base;
    const Pose2 end = report.path.back().map_from_base;
    report.drift_removed_m = std::max(
        report.drift_removed_m, std::hypot(by_odometry.x_m - end.x_m, by_odometry.y_m - end.y_m));
  }
}

absl::StatusOr<MappingResult> Mapper::Work::Finish(const ProgressFn& progress) {
  if (finished_) return absl::FailedPreconditionError("the mapping is finished already");
  finished_ = true;
  drives_.back()->Process(/*end=*/true);
  for (std::size_t i = 0; i < drives_.size(); ++i) {
    if (drives_[i]->registration.graph.scans.empty()) return NothingToMap(i);
  }
  const auto part = [&progress](double begin, double end) -> ProgressFn {
    if (!progress) return {};
    return [&progress, begin, end](double done) { return progress(begin + (end - begin) * done); };
  };
  if (!surveyed_.empty()) {
    if (const absl::Status status = ApplySurveyedPoses(); !status.ok()) return status;
  }
  absl::Status status = PlaceDrives(part(0.0, kPlaced));
  if (!status.ok()) return status;
  const bool all_fixed = std::all_of(graph_.scans.begin(), graph_.scans.end(),
                                     [](const KeyScan& scan) { return scan.fixed; });
  if (!all_fixed || graph_.scans.size() == 1) {
    status = RelaxScans(graph_.scans, building_surface_, config_.surface_voxel_size_m,
                        config_.relaxation_passes, part(kPlaced, kRelaxed), mean_residual_m_);
    if (!status.ok()) return status;
  }
  if (!extend_ && surveyed_.empty()) ReturnToStart();
  auto octree =
      CastRays(graph_.scans, extend_ ? extend_->octree.get() : nullptr, config_.voxel_size_m,
               config_.surface_voxel_size_m, config_.occupancy, part(kRelaxed, kCast));
  if (!octree.ok()) return octree.status();
  auto floor_plan = Slice(**octree);
  if (!floor_plan.ok()) return floor_plan.status();
  if (progress && !progress(1.0)) return Cancelled();

  MappingResult result{{*std::move(octree), *std::move(floor_plan)}, {}};
  Report(result.report);
  return result;
}

absl::StatusOr<Mapper> Mapper::Create(const MapperConfig& config,
                                      const frames::Calibration& calibration,
                                      const Pose2& map_from_base, std::vector<StampedPose> surveyed,
                                      std::shared_ptr<const building::Building> extend) {
  for (const absl::Status& status : {config.Validate(), calibration.Validate()}) {
    if (!status.ok()) return status;
  }
  if (!IsFinite(map_from_base)) {
    return absl::InvalidArgumentError("the mapping drive's initial pose is not finite");
  }
  if (extend && !extend->octree) {
    return absl::InvalidArgumentError(
        "a map that is known by its floor plan alone cannot be extended by LIDAR drives");
  }
  if (extend && !surveyed.empty()) {
    return absl::InvalidArgumentError(
        "a map is extended either by registration or by surveyed poses, not by both");
  }
  auto poses = SurveyedPoses::Create(std::move(surveyed));
  if (!poses.ok()) return poses.status();
  return Mapper(std::make_unique<Work>(config, calibration, map_from_base, *std::move(poses),
                                       std::move(extend)));
}

Mapper::Mapper(std::unique_ptr<Work> work) : work_(std::move(work)) {}
Mapper::Mapper(Mapper&&) noexcept = default;
Mapper& Mapper::operator=(Mapper&&) noexcept = default;
Mapper::~Mapper() = default;

absl::Status Mapper::Add(const frames::Frame& frame) { return work_->Add(frame); }

absl::Status Mapper::BeginDrive(const frames::Calibration& calibration,
                                std::optional<Pose2> map_from_base) {
  return work_->BeginDrive(calibration, map_from_base);
}

absl::StatusOr<MappingResult> Mapper::Finish(const std::function<bool(double)>& progress) {
  return work_->Finish(progress);
}

}  // namespace soundmap::mapping
