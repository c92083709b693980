#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "acoustics/likelihood_scan.h"
#include "building/free_space.h"
#include "geometry/angles.h"
#include "geometry/directions.h"
#include "localization/pose_estimate.h"
#include "ray_casting/range_index.h"
#include "sound_map/evidence.h"

namespace octomap {
class OcTree;
}

namespace soundmap::ray_casting {

// What says how far away the surface in a direction is.
enum class RangeSource {
  kLidar,  // section V: the LIDAR scan nearest in time
  kMap,    // the paper's ref. [7]: the first occupied voxel of the building's octree
};

// What a voxel is told in which several candidate directions of one scan end.
enum class SharedVoxel {
  kEach,  // section V: each of them
  kOnce,  // one observation, with the largest likelihood: a voxel emits if any part of it does, so
          // that what one direction hears there is not taken back by its neighbours', and one
          // observation counts once
};

struct RayCastingConfig {
  RangeSource range = RangeSource::kLidar;
  double voxel_size_m = 0.05;
  double max_range_m = 6.0;    // R_max; a direction whose range is beyond it updates nothing
  double max_angle_deg = 3.0;  // between candidate direction and LIDAR point; epsilon = 1 - cos,
                               // which the paper does not give
  SharedVoxel shared_voxel = SharedVoxel::kOnce;
  // Whether something may be heard where the building's map knows that there is nothing. If not, a
  // person who walks by and talks leaves nothing in the sound map.
  bool evidence_in_free_space = false;
  double max_lidar_age_s =
      0.5;  // between the LIDAR scan's reference time and the middle of the audio scan

  // InvalidArgument with a sentence that names the field at fault.
  absl::Status Validate() const;
};

RayCastingConfig PaperConfig();
RayCastingConfig DefaultConfig();

// What a building's octree tells ray casting; both null: it is known by its floor plan alone.
struct Surroundings {
  std::shared_ptr<const octomap::OcTree> octree;
  std::shared_ptr<const building::FreeSpace> free_space;
};

// What the LIDAR saw around an audio scan.
struct LidarView {
  frames::TimeNs reference_ns = 0;
  // In base_link at the reference time, as frames::PointsInBaseAt() makes them.
  std::span<const Eigen::Vector3f> point_in_base;
  // By odometry: reference_base_from_audio_base takes base_link at the middle of the audio scan to
  // base_link at the reference time.
  Eigen::Isometry3d reference_base_from_audio_base = Eigen::Isometry3d::Identity();
};

// Section V: sends each candidate direction out to the surface that is there. Immutable; any number
// of threads.
class RayCaster {
 public:
  // `directions` in mic_array; `base_from_array` may be any rotation.
  // InvalidArgument: as RayCastingConfig::Validate(), no directions, a mounting that is not finite.
  // FailedPrecondition: ranges from a map that has no octree.
  static absl::StatusOr<RayCaster> Create(const RayCastingConfig& config,
                                          geometry::DirectionGrid directions,
                                          const Eigen::Isometry3d& base_from_array,
                                          Surroundings surroundings = {});

  // `pose` at the middle of the scan. End points stand in the order of the directions (kOnce: of
  // the first that hit the voxel). `lidar` is not looked at when the ranges are the map's.
  // FailedPrecondition: the robot is lost, the LIDAR scan is stale.
  // InvalidArgument: the likelihood scan has a fault or another grid, the pose or the odometry is
  // not finite.
  absl::StatusOr<sound_map::EvidenceScan> Cast(const acoustics::LikelihoodScan& likelihood,
                                               const LidarView& lidar,
                                               const localization::PoseEstimate& pose) const;

 private:
  RayCaster(const RayCastingConfig& config, geometry::DirectionGrid directions,
            const Eigen::Isometry3d& base_from_array, Surroundings surroundings)
      : config_(config),
        directions_(std::move(directions), geometry::RadFromDeg(config.max_angle_deg)),
        base_from_array_(base_from_array),
        surroundings_(std::move(surroundings)) {}

  // The voxel where each direction ends, as RangeIndex::EndKeys() has them.
  std::vector<std::uint64_t> EndsByLidar(const LidarView& lidar,
                                         const Eigen::Isometry3d& map_from_array) const;
  std::vector<std::uint64_t> EndsInMap(const Eigen::Isometry3d& map_from_array) const;
  bool IsHeardInFreeSpace(std::uint64_t key, float likelihood) const;

  RayCastingConfig config_;
  LookUpDirections directions_;
  Eigen::Isometry3d base_from_array_;
  Surroundings surroundings_;
};

}  // namespace soundmap::ray_casting
