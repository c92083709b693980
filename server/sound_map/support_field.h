#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <vector>

#include "absl/functional/function_ref.h"
#include "sound_map/snapshot.h"

namespace soundmap::sound_map {

struct ObservedVoxel {
  geometry::VoxelKey key;
  Voxel fields;
  Support support;
};

// The voxels of a growing map that at least one observation supported and with M > min_updates,
// among all others, to be asked what was observed around a place. Tiles that stay as they are are
// not read again.
class SupportField {
 public:
  // Observations around a voxel are counted together, weighted by a Gaussian of the distance that
  // ends at 2.5 sigma on each axis, sigma being at most kMaxSigma_voxels. Of more than `max_voxels`
  // voxels those with the most support take part, and none of those that have equally little.
  static constexpr double kMaxSigma_voxels = 10.0;
  SupportField(double sigma_m, std::uint32_t min_updates, int max_voxels);

  // Goes on to another snapshot of the same map. Returns the tiles in which something may be
  // counted otherwise than before; some of them may be gone.
  std::vector<TileKey> Follow(const Snapshot& snapshot);

  double voxel_size_m() const { return voxel_size_m_; }

  // Those within the radius, in map order of their 8^3 blocks.
  std::vector<const ObservedVoxel*> Around(const Eigen::Vector3d& point_in_map,
                                           double radius_m) const;

  struct Counts {
    double supporting = 0.0;
    double all = 0.0;
  };
  // For each voxel of a tile that more than `min_share` of its own observations supported, and more
  // than one. Counts are exact to 1e-5 of themselves. `snapshot`: that of Follow().
  void ForEachCount(const Snapshot& snapshot, const TileKey& tile, double min_share,
                    absl::FunctionRef<void(const ObservedVoxel&, const Counts&)> visit) const;

 private:
  struct TileSupport {
    std::uint64_t revision = 0;
    std::vector<ObservedVoxel> voxels;  // in map order
  };
  class Surroundings;

  void Read(const Tile& tile, TileSupport& support) const;
  std::uint32_t LeastCount() const;
  // Those of one 8^3 block that take part.
  void ForEachInBlock(const geometry::VoxelKey& block,
                      absl::FunctionRef<void(const ObservedVoxel&)> visit) const;

  const double sigma_m_;
  const std::uint32_t min_updates_;
  const int max_voxels_;
  double voxel_size_m_ = 0.0;
  std::map<TileKey, TileSupport> tiles_;
  std::uint32_t least_count_ = 1;  // voxels with less support do not take part
};

}  // namespace soundmap::sound_map
