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
  // What moves is unlearned sooner than by OctoMap's sensor model (miss 0.4), and what was seen
  // free often is not made occupied by a few people who walk through.
  OccupancyConfig occupancy{.miss_log_odds = -0.6, .min_log_odds = -8.0};
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
  double key_scan_distance_m = 0.2;
  double key_scan_angle_rad = 0.2;
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
  int scans_unregistered = 0;  // did not fit the map; by odometry alone
  int key_scans = 0;           // kept for the octree
  // Places that the robot may have come back to; of these, found again and tied together; and found
  // but contradicting what else is known.
  int loops_tried = 0;
  int loops_closed = 0;
  int loops_refused = 0;
  double mean_residual_m = 0.0;  // of the key scans' points to the surfaces; 0 with surveyed poses
  // Between the odometry's end of the path and the corrected one; of several drives the largest.
  double drift_removed_m = 0.0;
  // Of every scan that was used, at the middle of its sweep; drive after drive.
  std::vector<StampedPose> path;
  std::vector<std::size_t> drive_begin;  // where each drive's part of the path begins
};

struct MappingResult {
  building::Building building;
  MappingReport report;
};

// Makes the geometric map of section II from mapping drives, fed frame by frame in the order of
// each drive. Each LIDAR sweep is straightened by the odometry and aligned in 6 degrees of freedom,
// of which the flat floor nearly holds three, to the surfaces around; places seen again close loops
// in a pose graph. Finish() brings the drives together, relaxes all kept scans against each other
// and casts their rays into the octree; what the LIDAR looks over near the robot is free where an
// LRF looks through it. The paper does this by 3DTK. Deterministic. Memory is bounded by the
// building and the number of drives, except 200 bytes of path a scan. One thread at a time.
class Mapper {
 public:
  // The first drive. `map_from_base` is the robot's pose at the first odometry of the drive and
  // fixes the map frame. With surveyed poses (two or more, times increasing) these are used instead
  // of registration; between them the robot moves as its odometry says; scans outside their span
  // are dropped. With a building to `extend` that one's frame is the map's and does not move:
  // `map_from_base` is then where the search for the drive's place begins.
  static absl::StatusOr<Mapper> Create(const MapperConfig& config,
                                       const frames::Calibration& calibration,
                                       const geometry::Pose2& map_from_base,
                                       std::vector<StampedPose> surveyed = {},
                                       std::shared_ptr<const building::Building> extend = nullptr);
  Mapper(Mapper&&) noexcept;
  Mapper& operator=(Mapper&&) noexcept;
  ~Mapper();

  // Frames that mapping does not need are ignored. InvalidArgument: a malformed frame; it is left
  // out and the next may follow.
  absl::Status Add(const frames::Frame& frame);

  // The frames that follow are a further drive's, of the same robot or another; they may be older.
  // `map_from_base`, if known, is where its place is searched for first; else it is found by its
  // surfaces. InvalidArgument: a calibration or pose that is not sound; the drive before goes on.
  absl::Status BeginDrive(const frames::Calibration& calibration,
                          std::optional<geometry::Pose2> map_from_base);

  // Once, after the last frame. `progress` gets 0 .. 1 now and then and returns false to cancel
  // (Cancelled). InvalidArgument: a drive gave no scan to map, with the reason. FailedPrecondition:
  // a drive does not overlap the others, or the building to extend. ResourceExhausted: the building
  // is too large for one map.
  absl::StatusOr<MappingResult> Finish(const std::function<bool(double)>& progress = {});

 private:
  class Work;
  explicit Mapper(std::unique_ptr<Work> work);

  std::unique_ptr<Work> work_;
};

}  // namespace soundmap::mapping
