#include "mapping/drive_registration.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/angles.h"
#include "mapping/planar_poses.h"

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;
using frames::TimeNs;
using geometry::Pose2;

// Below this a registration is not believed.
constexpr int kMinInliers = 30;
constexpr double kMinFit = 0.5;
// Below this the search is widened.
constexpr double kGoodFit = 0.7;
constexpr double kGoodOverlap = 0.5;
constexpr double kWideSearch_m = 1.0;
// Part of the recent scans' share of inliers that a good fit reaches; what another must have more.
constexpr double kGoodShare = 0.9;
constexpr double kBetter = 1.15;
constexpr double kMuchBetter = 1.25;  // from further away
// How fast that share is forgotten.
constexpr double kShareGain = 0.2;

// Odometry errs by this part of its step, and at least by the first figure.
constexpr double kPriorMin_m = 0.03;
constexpr double kPriorMin_rad = 0.02;
constexpr double kPriorOfStep = 0.2;

// The map to which scans are aligned is looked over, and a loop looked for, after so much way.
constexpr double kRenewal_m = 2.0;
constexpr double kLoopInterval_m = 1.0;
// Key scans further away than this show other surfaces.
constexpr double kLocal_m = 20.0;

std::vector<Eigen::Vector3f> Transform(const Isometry3d& map_from_base,
                                       std::span<const Eigen::Vector3f> point_in_base) {
  const Eigen::Isometry3f transform = map_from_base.cast<float>();
  std::vector<Eigen::Vector3f> point_in_map;
  point_in_map.reserve(point_in_base.size());
  for (const Eigen::Vector3f& point : point_in_base) point_in_map.push_back(transform * point);
  return point_in_map;
}

}  // namespace

DriveRegistration::DriveRegistration(const DriveRegistrationConfig& config,
                                     const Pose2& map_from_base)
    : config_(config),
      start_map_from_base_(map_from_base),
      local_map_(config.surface_voxel_size_m),
      places_(config.key_scans_per_place) {}

void DriveRegistration::Add(const PreparedScan& scan, const ScanPreparation& preparation) {
  const Prediction predicted = Predict(scan, preparation);
  Isometry3d map_from_base = predicted.map_from_base.ToIsometry();
  int anchor = path.empty() ? 0 : path.back().scan;
  std::optional<Registration> registration;
  bool placed = true;
  if (config_.align && local_map_.size() > 0) {
    const AlignedPoints aligned = PointsToAlign(scan.point_in_base, config_.surface_voxel_size_m);
    registration = Align(aligned, predicted, scan.stamp_ns);
    if (registration->inliers >= kMinInliers && registration->fit() >= kMinFit) {
      map_from_base = registration->map_from_base;
      const double share =
          static_cast<double>(registration->inliers) / static_cast<double>(aligned.points.size());
      seen_share_ += kShareGain * (share - seen_share_);
      anchor = NearestLocalScan(map_from_base);
    } else {
      ++unregistered;
      // By odometry where nothing speaks against it: a new part of the building, or one without
      // walls.
      placed = predicted.odometry_is_sound && registration->constraints < kMinInliers;
      registration.reset();
    }
  }
  // The first scan is always kept.
  if (placed && IsKeyScan(scan, map_from_base) &&
      (places_.Take(geometry::ProjectToFloor(map_from_base)) || graph.scans.empty())) {
    Keep(scan, map_from_base, anchor, registration);
    anchor = static_cast<int>(graph.scans.size()) - 1;
  }
  path.push_back({scan.stamp_ns, scan.odom_from_base, anchor,
                  graph.scans[anchor].map_from_base.inverse() * map_from_base});
  if (config_.align) CloseLoops(anchor);
}

DriveRegistration::Prediction DriveRegistration::Predict(const PreparedScan& scan,
                                                         const ScanPreparation& preparation) const {
  if (path.empty()) {
    return {start_map_from_base_ * preparation.first_odom_from_base()->Inverse() *
            scan.odom_from_base};
  }
  const PathEntry& last = path.back();
  const Pose2 map_from_last = geometry::ProjectToFloor(PoseOf(last));
  const Pose2 last_from_base = last.odom_from_base.Inverse() * scan.odom_from_base;
  const bool sound = preparation.limits().Allow(last_from_base, scan.stamp_ns - last.stamp_ns);
  return {sound ? map_from_last * last_from_base : map_from_last, sound};
}

Registration DriveRegistration::Align(const AlignedPoints& aligned, const Prediction& predicted,
                                      TimeNs stamp_ns) const {
  const PathEntry& last = path.back();
  const Pose2 map_from_last = geometry::ProjectToFloor(PoseOf(last));
  const double step_m = Distance(predicted.map_from_base, map_from_last);
  const double step_rad =
      std::abs(geometry::NormalizeAngle(predicted.map_from_base.yaw_rad - map_from_last.yaw_rad));
  const SearchRange near{.start_distance_m = 0.3,
                         .prior_std_m = kPriorMin_m + kPriorOfStep * step_m,
                         .prior_std_rad = kPriorMin_rad + kPriorOfStep * step_rad,
                         .point_weight = aligned.stands_for};
  Registration best =
      Register(aligned.points, local_map_, predicted.map_from_base.ToIsometry(), near);
  // The odometry may have slipped or jumped: look from where the robot would be if it had stood or
  // gone on as before.
  std::vector<Pose2> starts = {map_from_last};
  if (path.size() >= 2) {
    const PathEntry& before = path[path.size() - 2];
    const double fraction = static_cast<double>(stamp_ns - before.stamp_ns) /
                            static_cast<double>(last.stamp_ns - before.stamp_ns);
    if (fraction < 5.0) {
      starts.push_back(
          geometry::Interpolate(geometry::ProjectToFloor(PoseOf(before)), map_from_last, fraction));
    }
  }
  // Walls across the way, which would tell, are out of reach where the robot has slipped far: then
  // fewer points than before lie on any.
  const bool less = static_cast<double>(best.inliers) <
                    kGoodShare * seen_share_ * static_cast<double>(aligned.points.size());
  if (less) {
    for (const Pose2& start : starts) {
      const Registration other = Register(aligned.points, local_map_, start.ToIsometry(), near);
      if (other.inliers > kBetter * best.inliers) best = other;
    }
  }
  if (!predicted.odometry_is_sound || best.fit() < kGoodFit || best.overlap < kGoodOverlap) {
    const SearchRange wide{.start_distance_m = kWideSearch_m,
                           .prior_std_m = 0.5,
                           .prior_std_rad = 0.2,
                           .point_weight = aligned.stands_for};
    starts.push_back(predicted.map_from_base);
    for (const Pose2& start : starts) {
      const Registration other = Register(aligned.points, local_map_, start.ToIsometry(), wide);
      if (other.inliers > kMuchBetter * best.inliers) best = other;
    }
  }
  return best;
}

bool DriveRegistration::IsKeyScan(const PreparedScan& scan, const Isometry3d& map_from_base) const {
  if (graph.scans.empty()) return true;
  // By odometry where scans are not aligned, since poses follow at the end.
  const Pose2 step =
      config_.align
          ? geometry::ProjectToFloor(graph.scans.back().map_from_base.inverse() * map_from_base)
          : last_key_odom_from_base_.Inverse() * scan.odom_from_base;
  return std::hypot(step.x_m, step.y_m) >= config_.key_scan_distance_m ||
         std::abs(step.yaw_rad) >= config_.key_scan_angle_rad;
}

int DriveRegistration::NearestLocalScan(const Isometry3d& map_from_base) const {
  int nearest = path.back().scan;
  double nearest_m2 =
      (graph.scans[nearest].map_from_base.translation() - map_from_base.translation())
          .squaredNorm();
  for (std::size_t i = 0; i < graph.scans.size(); ++i) {
    if (!in_local_map_[i]) continue;
    const double squared_m2 =
        (graph.scans[i].map_from_base.translation() - map_from_base.translation()).squaredNorm();
    if (squared_m2 >= nearest_m2) continue;
    nearest = static_cast<int>(i);
    nearest_m2 = squared_m2;
  }
  return nearest;
}

void DriveRegistration::Keep(const PreparedScan& scan, const Isometry3d& map_from_base, int anchor,
                             const std::optional<Registration>& registration) {
  KeyScan key_scan;
  key_scan.map_from_base = map_from_base;
  key_scan.lidar_in_base = scan.lidar_in_base;
  key_scan.seen_through = scan.seen_through;
  for (const std::uint32_t i : FirstPointPerCube(scan.point_in_base, config_.voxel_size_m)) {
    key_scan.point_in_base.push_back(scan.point_in_base[i]);
    key_scan.part.push_back(scan.part[i]);
  }
  last_key_odom_from_base_ = scan.odom_from_base;
  const int index = static_cast<int>(graph.scans.size());
  graph.scans.push_back(std::move(key_scan));
  in_local_map_.push_back(config_.align);
  if (index == 0) {
    graph.scans.front().fixed = true;
  } else {
    const Isometry3d between = graph.Between(anchor, index);
    const Eigen::Matrix<double, 6, 6> seen =
        registration ? registration->information : Eigen::Matrix<double, 6, 6>::Zero();
    graph.edges.push_back(
        {anchor, index, between, EdgeInformation(between, seen, EdgeKind::kDrive)});
    const double step_m = graph.Between(index - 1, index).translation().norm();
    since_renewal_m_ += step_m;
    since_loop_m_ += step_m;
  }
  if (!config_.align) return;
  local_map_.Insert(Transform(map_from_base, graph.scans.back().point_in_base));
  local_map_.FitPlanes();
}

void DriveRegistration::CloseLoops(int scan) {
  if (since_loop_m_ < kLoopInterval_m) return;
  since_loop_m_ = 0.0;
  const bool closed = CloseLoop(graph, scan, config_.surface_voxel_size_m, loops);
  if (closed || since_renewal_m_ >= kRenewal_m) RenewLocalMap(scan, closed);
}

// Only trusted scans stay in the local map. It is made anew where it would differ.
void DriveRegistration::RenewLocalMap(int scan, bool moved) {
  since_renewal_m_ = 0.0;
  const std::vector<ScanUncertainty> uncertainty = graph.UncertaintyFrom(scan);
  std::vector<bool> wanted(graph.scans.size(), false);
  bool differs = moved;
  for (std::size_t i = 0; i < graph.scans.size(); ++i) {
    const double distance_m = graph.Between(scan, static_cast<int>(i)).translation().norm();
    wanted[i] = Trusted(uncertainty[i]) && distance_m <= kLocal_m;
    // What is out of sight may stay until the map is made anew.
    differs = differs || (wanted[i] != in_local_map_[i] && distance_m <= kLocal_m);
  }
  if (!differs) return;
  in_local_map_ = std::move(wanted);
  local_map_ = SurfaceMap(config_.surface_voxel_size_m);
  for (std::size_t i = 0; i < graph.scans.size(); ++i) {
    if (!in_local_map_[i]) continue;
    local_map_.Insert(Transform(graph.scans[i].map_from_base, graph.scans[i].point_in_base));
  }
  local_map_.FitPlanes();
}

}  // namespace soundmap::mapping
