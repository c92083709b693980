#pragma once

#include <Eigen/Core>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "building/building.h"

namespace soundmap::building {

struct PointCloudConfig {
  double voxel_size_m = 0.05;
  // The floor, in `map`: points within the tolerance of this height are floor.
  double floor_height_m = 0.0;
  double floor_tolerance_m = 0.1;
  // Air is assumed from a floor point up to the next point above it, or up to this height where
  // there is none.
  double air_height_m = 2.0;
  // Holes of the seen floor (between the rings of a LIDAR) up to this width are free, too.
  double floor_gap_m = 0.4;
  // The floor plan's slice.
  double slice_min_height_m = 0.2;
  double slice_max_height_m = 0.5;

  absl::Status Validate() const;
};

// A building from points on its surfaces, in `map`. A voxel with a point is occupied. Points alone
// do not say what is free, so free is where the floor was seen: the voxels above it up to the next
// occupied one of the column (a floor is seen through air). In the floor plan, narrow holes between
// free cells of a row or column are filled, never through an occupied cell. Where no floor point
// lies near floor_height_m, the plan's free cells are instead those that the occupied ones enclose.
// InvalidArgument: a point outside the octree, neither floor nor closed outline.
absl::StatusOr<Building> BuildingFromPoints(std::span<const Eigen::Vector3d> point_in_map,
                                            const PointCloudConfig& config);

}  // namespace soundmap::building
