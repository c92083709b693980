#pragma once

#include <functional>
#include <vector>

#include "absl/status/statusor.h"
#include "building/floor_plan.h"
#include "mapping/laser_loops.h"

namespace soundmap::mapping {

// Where the walls of a floor plan are: centres of the occupied cells that border on free ones, or
// of all where none does.
std::vector<Eigen::Vector2f> WallPoints(const building::FloorPlan& floor_plan);

// Occupied, free and unknown cells from the rays of the key scans; with a floor plan to `extend`,
// in its cells, which hold where no ray passes. Cancelled when `progress` (0 ..
// 1) returns false; ResourceExhausted: the building is too large for one map.
absl::StatusOr<building::FloorPlan> DrawFloorPlan(const FloorPlanMapperConfig& config,
                                                  const std::vector<LaserKeyScan>& key_scans,
                                                  const building::FloorPlan* extend,
                                                  const std::function<bool(double)>& progress);

}  // namespace soundmap::mapping
