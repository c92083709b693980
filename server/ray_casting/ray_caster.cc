#include "ray_casting/ray_caster.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

absl::Status CheckRange(const char* field, double value, double min, double max) {
  if (value >= min && value <= max) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("ray casting's ", field, " is ", value, ", but must be ", min, " to ", max));
}

std::uint64_t KeyOf(const geometry::VoxelKey& voxel) {
  return std::uint64_t{voxel.x} << 32 | std::uint64_t{voxel.y} << 16 | voxel.z;
}

geometry::VoxelKey VoxelFrom(std::uint64_t key) {
  return {static_cast<std::uint16_t>(key >> 32), static_cast<std::uint16_t>(key >> 16),
          static_cast<std::uint16_t>(key)};
}

// Several end points of one scan in one voxel become one, at the place of the first.
class SharedVoxels {
 public:
  explicit SharedVoxels(std::size_t end_points)
      : slots_(std::bit_ceil(2 * end_points + 1), kFree),
        shift_(64 - std::bit_width(slots_.size() - 1)) {}

  void Add(std::uint64_t key, float likelihood, std::vector<sound_map::EndPoint>* end_points) {
    const geometry::VoxelKey voxel = VoxelFrom(key);
    std::size_t slot = (key * 0x9e3779b97f4a7c15u) >> shift_;
    for (; slots_[slot] != kFree; slot = (slot + 1) & (slots_.size() - 1)) {
      sound_map::EndPoint& known = (*end_points)[slots_[slot]];
      if (known.key != voxel) continue;
      known.likelihood = std::max(known.likelihood, likelihood);
      return;
    }
    slots_[slot] = static_cast<std::uint32_t>(end_points->size());
    end_points->push_back({voxel, likelihood});
  }

 private:
  static constexpr std::uint32_t kFree = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> slots_;  // places among the end points; half of them or more are free
  int shift_;
};

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
  config.evidence_in_free_space = true;
  return config;
}

RayCastingConfig DefaultConfig() { return {}; }

absl::StatusOr<RayCaster> RayCaster::Create(const RayCastingConfig& config,
                                            geometry::DirectionGrid directions,
                                            const Eigen::Isometry3d& base_from_array,
                                            Surroundings surroundings) {
  if (absl::Status status = config.Validate(); !status.ok()) return status;
  if (directions.size() == 0) {
    return absl::InvalidArgumentError("ray casting has no candidate directions");
  }
  if (!base_from_array.matrix().allFinite()) {
    return absl::InvalidArgumentError("the mounting of the microphone array is not finite");
  }
  if (config.range == RangeSource::kMap && surroundings.octree == nullptr) {
    return absl::FailedPreconditionError(
        "ray_casting.range is the map, but the building is known by its floor plan alone");
  }
  return RayCaster(config, std::move(directions), base_from_array, std::move(surroundings));
}

std::vector<std::uint64_t> RayCaster::EndsByLidar(const LidarView& lidar,
                                                  const Eigen::Isometry3d& map_from_array) const {
  thread_local RangeIndex index;  // keeps its memory
  index.Make(lidar.point_in_base, lidar.reference_base_from_audio_base * base_from_array_);
  const std::vector<std::int32_t> nearest = index.Nearest(directions_);
  return index.EndKeys(directions_, nearest, map_from_array, config_.max_range_m,
                       config_.voxel_size_m);
}

std::vector<std::uint64_t> RayCaster::EndsInMap(const Eigen::Isometry3d& map_from_array) const {
  const Eigen::Vector3f array = map_from_array.translation().cast<float>();
  const octomap::point3d origin(array.x(), array.y(), array.z());
  std::vector<std::uint64_t> keys(static_cast<std::size_t>(directions_.size()), kNoKey);
  for (int i = 0; i < directions_.size(); ++i) {
    const Eigen::Vector3f direction =
        (map_from_array.linear() * directions_.grid()[i]).cast<float>();
    octomap::point3d end;
    if (!surroundings_.octree->castRay(origin, {direction.x(), direction.y(), direction.z()}, end,
                                       /*ignoreUnknownCells=*/true, config_.max_range_m)) {
      continue;
    }
    const auto voxel =
        geometry::KeyFromPoint(Eigen::Vector3d(end.x(), end.y(), end.z()), config_.voxel_size_m);
    if (voxel) keys[i] = KeyOf(*voxel);
  }
  return keys;
}

bool RayCaster::IsHeardInFreeSpace(std::uint64_t key, float likelihood) const {
  return !config_.evidence_in_free_space && surroundings_.free_space && likelihood > 0.5f &&
         surroundings_.free_space->Contains(
             geometry::PointFromKey(VoxelFrom(key), config_.voxel_size_m));
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
  for (const int i : likelihood.maxima) {
    if (i < 0 || i >= directions_.size()) {
      return absl::InvalidArgumentError(absl::StrCat(
          "the likelihood scan has a maximum in direction ", i, " of ", directions_.size()));
    }
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
  if (config_.range == RangeSource::kLidar && !(age_s <= config_.max_lidar_age_s)) {
    return absl::FailedPreconditionError(absl::StrCat("the LIDAR scan is ", age_s,
                                                      " s away from the audio scan; at most ",
                                                      config_.max_lidar_age_s, " s are allowed"));
  }

  const Eigen::Isometry3d map_from_array = map_from_base.ToIsometry() * base_from_array_;
  const std::vector<std::uint64_t> keys = config_.range == RangeSource::kLidar
                                              ? EndsByLidar(lidar, map_from_array)
                                              : EndsInMap(map_from_array);

  sound_map::EvidenceScan evidence;
  evidence.stamp_ns = likelihood.mid_ns();
  evidence.end_points.reserve(keys.size());
  SharedVoxels shared(config_.shared_voxel == SharedVoxel::kOnce ? keys.size() : 0);
  for (std::size_t i = 0; i < keys.size(); ++i) {
    if (keys[i] == kNoKey || IsHeardInFreeSpace(keys[i], likelihood.likelihood[i])) continue;
    if (config_.shared_voxel == SharedVoxel::kOnce) {
      shared.Add(keys[i], likelihood.likelihood[i], &evidence.end_points);
    } else {
      evidence.end_points.push_back({VoxelFrom(keys[i]), likelihood.likelihood[i]});
    }
  }
  for (const int i : likelihood.maxima) {
    if (keys[i] != kNoKey) evidence.maxima.push_back(VoxelFrom(keys[i]));
  }
  return evidence;
}

}  // namespace soundmap::ray_casting
