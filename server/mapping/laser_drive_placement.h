#pragma once

#include <optional>
#include <vector>

#include "building/floor_plan.h"
#include "geometry/pose.h"
#include "mapping/laser_loops.h"

namespace soundmap::mapping {

// Where a drive's own map, its loops closed, lies in a floor plan: near where it is if
// `near_start`, else, or if it does not fit there, anywhere. Some metres of its way must lie in
// what the plan knows to be free, see its walls where they are, be held by them in every direction
// and look through none; and no other place may do nearly as well. None if that fails.
std::optional<geometry::Pose2> PlaceLaserDrive(const std::vector<LaserKeyScan>& drive,
                                               const building::FloorPlan& plan, double wall_piece_m,
                                               bool near_start);

}  // namespace soundmap::mapping
