#pragma once

#include <Eigen/Core>
#include <functional>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "mapping/floor_plan_mapper.h"
#include "mapping/laser_alignment.h"
#include "mapping/laser_loops.h"

namespace soundmap::mapping {

// Where a key scan's points lie.
std::vector<Eigen::Vector2f> InMap(const LaserKeyScan& key_scan);

// Aligns every key scan to the walls of all of them, as often as the configuration says. The first
// stays; or, where there are `walls` of a map that exists, those stay and outweigh any number of
// scans. Cancelled when `progress` (0 .. 1) returns false.
absl::Status RelaxLaserScans(const FloorPlanMapperConfig& config,
                             std::span<const Eigen::Vector2f> walls,
                             const std::function<bool(double)>& progress,
                             std::vector<LaserKeyScan>& key_scans, double& mean_residual_m);

// Scans between two key scans move with these: as they were placed at first, and what is left is
// spread over them in time.
void PlacePath(const std::vector<LaserKeyScan>& key_scans, std::vector<LaserPathEntry>& path);

}  // namespace soundmap::mapping
