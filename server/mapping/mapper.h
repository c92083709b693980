#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "building/building.h"
#include "frames/frames.h"
#include "geometry/pose.h"
#include "mapping/occupancy_grid.h"

namespace soundmap::mapping {

struct MapperConfig {
  double voxel_size_m = 0.05;  // of the octree (section II)
  OccupancyConfig occupancy;
  // LIDAR points nearer than this belong to the robot; further ones are left out.
  double min_range_m = 0.4;
  double max_range_m = 40.0;
  // The floor plan's slice: this far above and below the LRF, or below and above `slice_height_m`
  // where that is given or the LRF is not mounted (at the height of the floor).
  double slice_half_thickness_m = 0.05;
  std::optional<double> slice_height_m;
  double slice_height_without_lrf_m = 0.3;
  // Voxels of the surfaces to which scans are aligned.
  double surface_voxel_size_m = 0.2;
  // A scan is kept when the robot has moved this far since the last kept one; each square metre and
  // quarter turn keeps only so many.
  double key_scan_distance_m = 0.15;
  double key_scan_angle_rad = 0.1;
  int key_scans_per_place = 16;
  // After the drive, each kept scan is aligned to all the others this many times.
  int relaxation_passes = 2;
  // Odometry that claims more is taken as a fault: the robot is then predicted to go on as before.
  double max_speed_mps = 4.0;
  double max_turn_rate_radps = 6.0;

  absl::Status Validate() const;
};

struct StampedPose {
  frames::TimeNs stamp_ns = 0;
  geometry::Pose2 map_from_base;
  bool operator==(const StampedPose&) const = default;
};

struct MappingReport {
  int scans = 0;  // LIDAR scans received
  // Without points in range, without odometry, with a jump of the odometry in them, not newer than
  // the one before, or outside the surveyed poses.
  int scans_dropped = 0;
  int scans_unregistered = 0;     // did not fit the map; by odometry alone
  int key_scans = 0;              // kept for the octree
  double mean_residual_m = 0.0;   // of the key scans' points to the surfaces; 0 with surveyed poses
  double drift_removed_m = 0.0;   // between the odometry's end of the path and the corrected one
  std::vector<StampedPose> path;  // of every scan that was used, at the middle of its sweep
};

struct MappingResult {
  building::Building building;
  MappingReport report;
};

// Makes the geometric map of section II from a mapping drive, fed frame by frame in the order of
// the drive. Each LIDAR sweep is straightened by the odometry and aligned to the surfaces mapped so
// far; Finish() relaxes all kept scans against each other and casts their rays into the octree. Not
// the paper's 3DTK: 3 degrees of freedom instead of 6, since the floor is flat, and no closing of
// loops larger than the LIDAR's view. Deterministic. Memory is bounded by the building, except 48
// bytes of path a scan. One thread at a time.
class Mapper {
 public:
  // `map_from_base` is the robot's pose at the first odometry of the drive and fixes the map frame.
  // With surveyed poses (two or more, times increasing) these are used instead of registration;
  // between them the robot moves as its odometry says; scans outside their span are dropped.
  static absl::StatusOr<Mapper> Create(const MapperConfig& config,
                                       const frames::Calibration& calibration,
                                       const geometry::Pose2& map_from_base,
                                       std::vector<StampedPose> surveyed = {});
  Mapper(Mapper&&) noexcept;
  Mapper& operator=(Mapper&&) noexcept;
  ~Mapper();

  // Frames that mapping does not need are ignored. InvalidArgument: a malformed frame; it is left
  // out and the next may follow.
  absl::Status Add(const frames::Frame& frame);

  // Once, after the last frame. `progress` gets 0 .. 1 now and then and returns false to cancel
  // (Cancelled). InvalidArgument: the drive gave no scan to map, with the reason.
  // ResourceExhausted: the building is too large for one map.
  absl::StatusOr<MappingResult> Finish(const std::function<bool(double)>& progress = {});

 private:
  class Drive;
  explicit Mapper(std::unique_ptr<Drive> drive);

  std::unique_ptr<Drive> drive_;
};

}  // namespace soundmap::mapping
