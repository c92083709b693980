#pragma once

#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "mapping/key_scan_graph.h"
#include "mapping/occupancy_grid.h"
#include "mapping/registration.h"

namespace octomap {
class OcTree;
}

namespace soundmap::mapping {

// Places of the surfaces of a building that exists: centres of the occupied voxels that border on
// free ones, or of all where none does.
std::vector<Eigen::Vector3f> SurfacePoints(const octomap::OcTree& octree);

// The surfaces of the key scans and of the building that they extend, for placing a drive.
SurfacePyramid AllSurfaces(const std::vector<KeyScan>& scans,
                           std::span<const Eigen::Vector3f> building, double voxel_size_m,
                           int levels);

// 0 to 1; false cancels.
using ProgressFn = std::function<bool(double)>;

// Aligns every key scan to the surfaces of all, and of the building that they extend, which weigh
// more than those of any number of scans at a place; `passes` times. Fixed scans stay; the first
// pose of all stays where nothing else is fixed. Cancelled by `progress`. `mean_residual_m` is that
// of the last pass.
absl::Status RelaxScans(std::vector<KeyScan>& scans, std::span<const Eigen::Vector3f> building,
                        double surface_voxel_size_m, int passes, const ProgressFn& progress,
                        double& mean_residual_m);

// The octree of section II: the rays of all key scans, cast into the voxels that `extend` knows, if
// it is given. At the height of the LRF, what no ray of the LIDAR has passed and the LRF has seen
// through is free, too: near the robot the LIDAR looks over it.
absl::StatusOr<std::shared_ptr<octomap::OcTree>> CastRays(
    const std::vector<KeyScan>& scans, const octomap::OcTree* extend, double voxel_size_m,
    double surface_voxel_size_m, const OccupancyConfig& config, const ProgressFn& progress);

}  // namespace soundmap::mapping
