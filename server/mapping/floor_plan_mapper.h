#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "building/building.h"
#include "frames/frames.h"
#include "geometry/angles.h"
#include "geometry/pose.h"
#include "mapping/mapper.h"
#include "mapping/occupancy_grid.h"

namespace soundmap::mapping {

struct FloorPlanMapperConfig {
  double cell_size_m = 0.05;  // of the floor plan
  OccupancyConfig occupancy;
  // Returns nearer than this belong to the robot; further ones are left out.
  double min_range_m = 0.1;
  double max_range_m = 40.0;
  // By how much the stamps of the scans are later than those of the odometry of the same moment;
  // none: told from the turns of the first minutes.
  std::optional<double> laser_lag_s;
  // A scan is kept when the robot has moved this far since the last kept one; each square metre and
  // quarter turn keeps only so many.
  double key_scan_distance_m = 0.2;
  double key_scan_angle_rad = geometry::RadFromDeg(9.0);
  int key_scans_per_place = 24;
  // Walls to which scans are aligned are pieces of this size; those of so much of the way count.
  double wall_piece_m = 0.2;
  double local_map_m = 8.0;
  // Stretches of the way, each of which is compared with all others near it.
  double stretch_m = 3.0;
  // How far off the pose may be after closing no loop for a way: from here on, and for each metre.
  double loop_search_m = 0.5;
  double loop_search_per_m = 0.03;
  double max_loop_search_m = 8.0;
  // After the loops are closed, each kept scan is aligned to all the others this many times.
  int relaxation_passes = 3;
  // Odometry that claims more is taken as a fault.
  double max_speed_mps = 4.0;
  double max_turn_rate_radps = 6.0;

  absl::Status Validate() const;
};

struct FloorPlanReport {
  int scans = 0;  // LRF scans received
  // Without returns in range, without odometry, not newer than the one before, or outside the
  // surveyed poses.
  int scans_dropped = 0;
  int scans_unregistered = 0;    // did not fit what was mapped; by odometry alone
  int key_scans = 0;             // kept
  int loops_closed = 0;          // stretches found at an earlier one
  int loops_refused = 0;         // of those found, as contradicting the others
  double laser_lag_s = 0.0;      // in use at the end; of several drives that of the first
  double mean_residual_m = 0.0;  // of the key scans' points to the walls; 0 with surveyed poses
  // Between the odometry's end of the path and the corrected one; of several drives the largest.
  double drift_removed_m = 0.0;
  // Of every scan that was used, at the middle of its sweep; drive after drive.
  std::vector<StampedPose> path;
  std::vector<std::size_t> drive_begin;  // where each drive's part of the path begins
};

struct FloorPlanResult {
  building::Building building;  // without an octree, but that of one that was extended
  FloorPlanReport report;
};

// Makes the floor plan of section II-A from drives with an LRF and odometry alone, fed frame by
// frame in the order of each drive. Each scan is aligned to the walls of the last metres; Finish()
// finds where the drives lie in each other, looks for stretches of the way at places seen before,
// closes these loops in a pose graph, relaxes all kept scans against each other and casts their
// rays. Times of the path and of surveyed poses are those of the scans. Deterministic. Memory is
// bounded by the building and the number of drives, except 80 bytes of path a scan. One thread at a
// time.
class FloorPlanMapper {
 public:
  // As Mapper::Create. InvalidArgument also: the LRF is tilted by more than 10 degrees. Of a
  // building to extend, the floor plan is extended, in its cells; an octree stays as it is.
  static absl::StatusOr<FloorPlanMapper> Create(
      const FloorPlanMapperConfig& config, const frames::Calibration& calibration,
      const geometry::Pose2& map_from_base, std::vector<StampedPose> surveyed = {},
      std::shared_ptr<const building::Building> extend = nullptr);
  FloorPlanMapper(FloorPlanMapper&&) noexcept;
  FloorPlanMapper& operator=(FloorPlanMapper&&) noexcept;
  ~FloorPlanMapper();

  // As Mapper's.
  absl::Status Add(const frames::Frame& frame);
  absl::Status BeginDrive(const frames::Calibration& calibration,
                          std::optional<geometry::Pose2> map_from_base);
  absl::StatusOr<FloorPlanResult> Finish(const std::function<bool(double)>& progress = {});

 private:
  class Work;
  explicit FloorPlanMapper(std::unique_ptr<Work> work);

  std::unique_ptr<Work> work_;
};

}  // namespace soundmap::mapping
