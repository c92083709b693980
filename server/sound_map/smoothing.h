#pragma once

#include <span>
#include <vector>

#include "geometry/voxel_key.h"
#include "sound_map/snapshot.h"

namespace soundmap::sound_map {

// The log-odds around each of the keys (in map order): over all voxels of the map, weighted by a Gaussian of the distance in voxels, cut off at
// 2.5 sigma on each axis, and divided by the weight of the voxels that exist. Silent surroundings pull a lone voxel down; unseen ones do not.
std::vector<float> SmoothLogOdds(const Snapshot& snapshot, std::span<const geometry::VoxelKey> keys,
                                 double sigma_voxels);

}  // namespace soundmap::sound_map
