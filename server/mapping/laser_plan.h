#pragma once

#include <functional>
#include <vector>

#include "absl/status/statusor.h"
#include "building/floor_plan.h"
#include "mapping/laser_loops.h"

namespace soundmap::mapping {

// Occupied, free and unknown cells from the rays of the key scans. Cancelled when `progress` (0 ..
// 1) returns false; ResourceExhausted: the building is too large for one map.
absl::StatusOr<building::FloorPlan> DrawFloorPlan(const FloorPlanMapperConfig& config,
                                                  const std::vector<LaserKeyScan>& key_scans,
                                                  const std::function<bool(double)>& progress);

}  // namespace soundmap::mapping
