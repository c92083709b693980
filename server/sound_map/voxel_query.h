#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "sound_map/snapshot.h"

namespace soundmap::sound_map {

struct VoxelQuery {
  // A voxel is in the box when its centre is.
  Eigen::Vector3d min_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d max_in_map_m = Eigen::Vector3d::Zero();
  std::uint32_t min_updates = 0;  // epsilon_C: only voxels with M > min_updates
  double min_probability = 0.0;   // 0 .. 1, of L
  int limit = 100'000;
  // Continue behind this voxel, the last of the page before; in a later snapshot new voxels may be
  // missed, none comes twice.
  std::optional<geometry::VoxelKey> after;
};

struct VoxelPage {
  std::vector<geometry::VoxelKey> keys;  // in map order
  std::vector<Voxel> voxels;             // one a key
  bool more = false;
};

// InvalidArgument: a bound that is not a number, or the box turned inside out, or a limit below 1.
// A box that reaches beyond the octree is cut to it.
absl::StatusOr<VoxelPage> FindVoxels(const Snapshot& snapshot, const VoxelQuery& query);

}  // namespace soundmap::sound_map
