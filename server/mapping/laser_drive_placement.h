#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "geometry/pose.h"
#include "mapping/laser_loops.h"

namespace soundmap::mapping {

// Where a drive's own map, its loops closed, lies in another one, by its walls: near where it is if
// `near_start`, else, or if it does not fit there, anywhere. Several pieces of the drive, spread
// over it, must be found where the others say that they are, held in every direction, and no other
// place may do nearly as well. None if that fails.
std::optional<geometry::Pose2> PlaceLaserDrive(const std::vector<LaserKeyScan>& drive,
                                               std::span<const Eigen::Vector2f> point_in_map,
                                               double wall_piece_m, bool near_start);

}  // namespace soundmap::mapping
