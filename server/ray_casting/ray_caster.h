#pragma once

#include <Eigen/Geometry>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "acoustics/likelihood_scan.h"
#include "geometry/angles.h"
#include "geometry/directions.h"
#include "localization/pose_estimate.h"
#include "ray_casting/range_index.h"
#include "sound_map/evidence.h"

namespace soundmap::ray_casting {

// What a voxel is told in which several candidate directions of one scan end.
enum class SharedVoxel {
  kEach,  // section V: each of them
  kOnce,  // one observation, with the largest likelihood: a voxel emits if any part of it does, so
          // that what one direction hears there is not taken back by its neighbours', and one
          // observation counts once
};

struct RayCastingConfig {
  double voxel_size_m = 0.05;
  double max_range_m = 6.0;    // R_max; a direction whose range is beyond it updates nothing
  double max_angle_deg = 3.0;  // between candidate direction and LIDAR point; epsilon = 1 - cos,
                               // which the paper does not give
  SharedVoxel shared_voxel = SharedVoxel::kOnce;
  double max_lidar_age_s =
      0.5;  // between the LIDAR scan's reference time and the middle of the audio scan

  // InvalidArgument with a sentence that names the field at fault.
  absl::Status Validate() const;
};

RayCastingConfig PaperConfig();
RayCastingConfig DefaultConfig();

// What the LIDAR saw around an audio scan.
struct LidarView {
  frames::TimeNs reference_ns = 0;
  // In base_link at the reference time, as frames::PointsInBaseAt() makes them.
  std::span<const Eigen::Vector3f> point_in_base;
  // By odometry: reference_base_from_audio_base takes base_link at the middle of the audio scan to
  // base_link at the reference time.
  Eigen::Isometry3d reference_base_from_audio_base = Eigen::Isometry3d::Identity();
};

// Section V: sends each candidate direction out to the surface that the LIDAR sees there.
// Immutable; any number of threads.
class RayCaster {
 public:
  // `directions` in mic_array; `base_from_array` may be any rotation.
  // InvalidArgument: as RayCastingConfig::Validate(), no directions, a mounting that is not finite.
  static absl::StatusOr<RayCaster> Create(const RayCastingConfig& config,
                                          geometry::DirectionGrid directions,
                                          const Eigen::Isometry3d& base_from_array);

  // `pose` at the middle of the scan. End points stand in the order of the directions (kOnce: of
  // the first that hit the voxel). FailedPrecondition: the robot is lost, the LIDAR scan is stale.
  // InvalidArgument: the likelihood scan has a fault or another grid, the pose or the odometry is
  // not finite.
  absl::StatusOr<sound_map::EvidenceScan> Cast(const acoustics::LikelihoodScan& likelihood,
                                               const LidarView& lidar,
                                               const localization::PoseEstimate& pose) const;

 private:
  RayCaster(const RayCastingConfig& config, geometry::DirectionGrid directions,
            const Eigen::Isometry3d& base_from_array)
      : config_(config),
        directions_(std::move(directions), geometry::RadFromDeg(config.max_angle_deg)),
        base_from_array_(base_from_array) {}

  RayCastingConfig config_;
  LookUpDirections directions_;
  Eigen::Isometry3d base_from_array_;
};

}  // namespace soundmap::ray_casting
