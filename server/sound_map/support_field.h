#pragma once

#include <Eigen/Core>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cstdint>
#include <vector>

#include "absl/functional/function_ref.h"
#include "sound_map/snapshot.h"

namespace soundmap::sound_map {

struct ObservedVoxel {
  geometry::VoxelKey key;
  Voxel fields;
  Support support;
};

// The voxels that at least one observation supported and with M > min_updates, in map order. Costs
// nothing where there are none.
std::vector<ObservedVoxel> FindSupportedVoxels(const Snapshot& snapshot, std::uint32_t min_updates);

// The supported voxels among all others, to be asked what was observed around a place. The snapshot
// must outlive it.
class SupportField {
 public:
  SupportField(const Snapshot& snapshot, std::vector<ObservedVoxel> supported);

  double voxel_size_m() const { return snapshot_.voxel_size_m(); }

  // Those within the radius, in map order of their 8^3 blocks.
  std::vector<const ObservedVoxel*> Around(const Eigen::Vector3d& point_in_map,
                                           double radius_m) const;

  // Observations around a voxel, weighted by a Gaussian of the distance that ends at 2.5 sigma on
  // each axis.
  struct Counts {
    double supporting = 0.0;
    double all = 0.0;
  };
  // For each voxel that more than `min_share` of its own observations supported, and more than one.
  void ForEachCount(double sigma_m, double min_share,
                    absl::FunctionRef<void(const ObservedVoxel&, const Counts&)> visit) const;

 private:
  const Snapshot& snapshot_;
  std::vector<ObservedVoxel> voxels_;
  struct Range {
    int begin = 0;
    int end = 0;
  };
  // By block: key >> 3.
  boost::unordered_flat_map<geometry::VoxelKey, Range, std::hash<geometry::VoxelKey>> blocks_;
};

}  // namespace soundmap::sound_map
