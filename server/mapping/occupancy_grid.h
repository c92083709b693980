#pragma once

#include <Eigen/Core>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "geometry/voxel_key.h"

namespace octomap {
class OcTree;
}

namespace soundmap::mapping {

// One LIDAR point and the way to it, in `map`.
struct Ray {
  Eigen::Vector3f origin_in_map;
  Eigen::Vector3f end_in_map;
  // The last part of the way that is not taken as free: a ray that grazes a surface passes through
  // its voxels.
  float margin_m = 0.0f;
};

struct OccupancyConfig {
  // OctoMap's sensor model: hit 0.7, miss 0.4, clamped to 0.12 .. 0.97, as log-odds. Clamped, so
  // that what moved away is unlearned.
  double hit_log_odds = 0.85;
  double miss_log_odds = -0.4;
  double min_log_odds = -2.0;
  double max_log_odds = 3.5;
  int max_blocks = 1 << 20;  // of 8^3 voxels and 1.3 KiB each

  absl::Status Validate() const;
};

// Occupied, free and unknown voxels from rays. Within a scan a voxel counts once, and a point in it
// outweighs the rays that pass through it.
class OccupancyGrid {
 public:
  OccupancyGrid(double voxel_size_m, const OccupancyConfig& config);
  ~OccupancyGrid();

  // Takes in what another map, of any voxel size, knows, as sure as OctoMap's limits allow. Before
  // the first scan. ResourceExhausted as InsertScan().
  absl::Status InsertKnown(const octomap::OcTree& octree);

  // Rays that leave the range of voxel keys are left out. ResourceExhausted: the map has grown
  // beyond max_blocks.
  absl::Status InsertScan(std::span<const Ray> rays);

  // Makes free what nothing is known of, along each ray as far as no occupied voxel stands in its
  // way. For a sensor that is less sure than the scans; after the last of them. ResourceExhausted
  // as InsertScan().
  absl::Status FillSeenThrough(std::span<const Ray> rays);

  // Pruned. A voxel alone that one scan hit and others saw through is free. Each known voxel is as
  // surely occupied or free as OctoMap allows (its clamping thresholds).
  std::shared_ptr<octomap::OcTree> ToOctree() const;

 private:
  struct Block;

  Block* BlockAt(int x, int y, int z);
  Block* Touch(Block* block);
  absl::Status MarkScan(std::span<const Ray> rays);
  bool CastFree(const Ray& ray);
  void CountMarks();
  bool IsSpeckle(const Block& block, int x, int y, int z) const;
  absl::Status Full() const;

  double voxel_size_m_;
  int hit_, miss_, min_, max_;  // log-odds in steps of 1e-3
  std::size_t max_blocks_;
  boost::unordered_flat_map<geometry::VoxelKey, std::uint32_t, std::hash<geometry::VoxelKey>>
      block_index_;  // by key / 8
  std::vector<std::unique_ptr<Block>> blocks_;
  std::vector<Block*> touched_;  // by the present scan
};

}  // namespace soundmap::mapping
