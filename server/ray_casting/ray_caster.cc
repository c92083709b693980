#include "ray_casting/ray_caster.h"

#include <algorithm>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cmath>
#include <cstdlib>

#include "absl/strings/str_cat.h"
#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

absl::Status CheckRange(const char* field, double value, double min, double max) {
  if (value >= min && value <= max) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("ray casting's ", field, " is ", value, ", but must be ", min, " to ", max));
}

// Several end points of one scan in one voxel become one, at the place of the first.
std::vector<sound_map::EndPoint> MergeShared(const std::vector<sound_map::EndPoint>& end_points) {
  std::vector<sound_map::EndPoint> merged;
  merged.reserve(end_points.size());
  boost::unordered_flat_map<geometry::VoxelKey, std::size_t, std::hash<geometry::VoxelKey>> place;
  place.reserve(end_points.size());
  for (const sound_map::EndPoint& end_point : end_points) {
    const auto [entry, is_new] = place.try_emplace(end_point.key, merged.size());
    if (is_new) {
      merged.push_back(end_point);
    } else {
      float& likelihood = merged[entry->second].likelihood;
      likelihood = std::max(likelihood, end_point.likelihood);
    }
  }
  return merged;
}

}  // namespace

absl::Status RayCastingConfig::Validate() const {
  for (const absl::Status& status : {CheckRange("voxel_size_m", voxel_size_m, 1e-3, 10.0),
                                     CheckRange("max_range_m", max_range_m, 1e-3, 1000.0),
                                     CheckRange("max_angle_deg", max_angle_deg, 1e-3, 45.0),
                                     CheckRange("max_lidar_age_s", max_lidar_age_s, 0.0, 3600.0)}) {
    if (!status.ok()) return status;
  }
  return absl::OkStatus();
}

RayCastingConfig PaperConfig() {
  RayCastingConfig config;
  config.shared_voxel = SharedVoxel::kEach;
  return config;
}

RayCastingConfig DefaultConfig() { return {}; }

absl::StatusOr<RayCaster> RayCaster::Create(const RayCastingConfig& config,
                                            geometry::DirectionGrid directions,
                                            const Eigen::Isometry3d& base_from_array) {
  if (absl::Status status = config.Validate(); !status.ok()) return status;
  if (directions.size() == 0) {
    return absl::InvalidArgumentError("ray casting has no candidate directions");
  }
  if (!base_from_array.matrix().allFinite()) {
    return absl::InvalidArgumentError("the mounting of the microphone array is not finite");
  }
  return RayCaster(config, std::move(directions), base_from_array);
}

absl::StatusOr<sound_map::EvidenceScan> RayCaster::Cast(
    const acoustics::LikelihoodScan& likelihood, const LidarView& lidar,
    const localization::PoseEstimate& pose) const {
  if (!likelihood.fault.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("the likelihood scan is not usable: ", likelihood.fault));
  }
  if (likelihood.likelihood.size() != static_cast<std::size_t>(directions_.size())) {
    return absl::InvalidArgumentError(absl::StrCat("the likelihood scan has ",
                                                   likelihood.likelihood.size(),
                                                   " directions, not ", directions_.size()));
  }
  const geometry::Pose2& map_from_base = pose.map_from_base;
  if (!std::isfinite(map_from_base.x_m) || !std::isfinite(map_from_base.y_m) ||
      !std::isfinite(map_from_base.yaw_rad) ||
      !lidar.reference_base_from_audio_base.matrix().allFinite()) {
    return absl::InvalidArgumentError(
        "the pose or the odometry of a likelihood scan is not finite");
  }
  if (pose.state == localization::State::kLost) {
    return absl::FailedPreconditionError("the robot is lost, so that its sound has no place");
  }
  const double age_s = std::abs(frames::SecondsFromNs(likelihood.mid_ns() - lidar.reference_ns));
  if (!(age_s <= config_.max_lidar_age_s)) {
    return absl::FailedPreconditionError(absl::StrCat("the LIDAR scan is ", age_s,
                                                      " s away from the audio scan; at most ",
                                                      config_.max_lidar_age_s, " s are allowed"));
  }

  thread_local RangeIndex index;  // keeps its memory
  index.Make(lidar.point_in_base, lidar.reference_base_from_audio_base * base_from_array_);
  const std::vector<std::int32_t> nearest = index.Nearest(directions_);
  const Eigen::Isometry3d map_from_array = map_from_base.ToIsometry() * base_from_array_;

  sound_map::EvidenceScan evidence;
  evidence.stamp_ns = likelihood.mid_ns();
  evidence.end_points.reserve(directions_.size());
  for (int i = 0; i < directions_.size(); ++i) {
    if (nearest[i] == kNoPoint) continue;
    const double range_m = index.Range_m(nearest[i]);
    if (range_m > config_.max_range_m) continue;
    // The ray has the length rho_i and keeps the candidate direction, not the LIDAR point's.
    const auto key = geometry::KeyFromPoint(map_from_array * (range_m * directions_.grid()[i]),
                                            config_.voxel_size_m);
    if (key) evidence.end_points.push_back({*key, likelihood.likelihood[i]});
  }
  if (config_.shared_voxel == SharedVoxel::kOnce) {
    evidence.end_points = MergeShared(evidence.end_points);
  }
  return evidence;
}

}  // namespace soundmap::ray_casting
