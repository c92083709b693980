#include "mapping/occupancy_grid.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"

namespace soundmap::mapping {
namespace {

constexpr int kBlockBits = 3;
constexpr int kBlockSize = 1 << kBlockBits;
constexpr double kStep_log_odds = 1e-3;

int CellInBlock(int x, int y, int z) {
  constexpr int kMask = kBlockSize - 1;
  return ((z & kMask) << (2 * kBlockBits)) | ((y & kMask) << kBlockBits) | (x & kMask);
}

int Steps(double log_odds) { return static_cast<int>(std::lround(log_odds / kStep_log_odds)); }

// Bits of the three numbers interleaved: neighbours in space are neighbours in order, which OctoMap
// inserts fast.
std::uint64_t MortonCode(const geometry::VoxelKey& key) {
  const auto spread = [](std::uint64_t bits) {
    bits = (bits | bits << 16) & 0x0000ff0000ffu;
    bits = (bits | bits << 8) & 0x00f00f00f00fu;
    bits = (bits | bits << 4) & 0x0c30c30c30c3u;
    return (bits | bits << 2) & 0x249249249249u;
  };
  return spread(key.x) | spread(key.y) << 1 | spread(key.z) << 2;
}

}  // namespace

struct OccupancyGrid::Block {
  struct Cell {
    std::int16_t log_odds = 0;
    // The scan that touched the voxel last, 0: none, unknown. Counted in a circle, so after 65535
    // scans a voxel may miss one update.
    std::uint16_t scan = 0;
  };

  geometry::VoxelKey key;  // of the block: voxel key / 8
  std::array<Cell, kBlockSize * kBlockSize * kBlockSize> cells;
};

absl::Status OccupancyConfig::Validate() const {
  if (!(hit_log_odds > 0.0 && hit_log_odds <= 10.0 && miss_log_odds < 0.0 &&
        miss_log_odds >= -10.0)) {
    return absl::InvalidArgumentError(
        "the occupancy's hit_log_odds must be from 0 to 10 and its miss_log_odds from -10 to 0");
  }
  if (!(min_log_odds < 0.0 && min_log_odds >= -20.0 && max_log_odds > 0.0 &&
        max_log_odds <= 20.0)) {
    return absl::InvalidArgumentError(
        "the occupancy's min_log_odds must be from -20 to 0 and its max_log_odds from 0 to 20");
  }
  if (max_blocks < 1) {
    return absl::InvalidArgumentError("the occupancy's max_blocks must be positive");
  }
  return absl::OkStatus();
}

OccupancyGrid::OccupancyGrid(double voxel_size_m, const OccupancyConfig& config)
    : voxel_size_m_(voxel_size_m),
      hit_(Steps(config.hit_log_odds)),
      miss_(Steps(config.miss_log_odds)),
      min_(Steps(config.min_log_odds)),
      max_(Steps(config.max_log_odds)),
      max_blocks_(static_cast<std::size_t>(config.max_blocks)) {}

OccupancyGrid::~OccupancyGrid() = default;

// Null when the map is full.
OccupancyGrid::Block* OccupancyGrid::BlockAt(int x, int y, int z) {
  const geometry::VoxelKey key{static_cast<std::uint16_t>(x >> kBlockBits),
                               static_cast<std::uint16_t>(y >> kBlockBits),
                               static_cast<std::uint16_t>(z >> kBlockBits)};
  const auto found = block_index_.find(key);
  if (found != block_index_.end()) return blocks_[found->second].get();
  if (blocks_.size() >= max_blocks_) return nullptr;
  block_index_.emplace(key, static_cast<std::uint32_t>(blocks_.size()));
  blocks_.push_back(std::make_unique<Block>());
  blocks_.back()->key = key;
  return blocks_.back().get();
}

inline void OccupancyGrid::Update(Block& block, int x, int y, int z, int change) {
  Block::Cell& cell = block.cells[CellInBlock(x, y, z)];
  if (cell.scan == scan_) return;
  cell.scan = scan_;
  cell.log_odds = static_cast<std::int16_t>(std::clamp(cell.log_odds + change, min_, max_));
}

// Marks the voxels on the way as missed, by exact traversal (Amanatides and Woo). False when the
// map is full.
bool OccupancyGrid::CastFree(const Ray& ray) {
  const Eigen::Vector3d origin = ray.origin_in_map.cast<double>() / voxel_size_m_;
  const Eigen::Vector3d way = ray.end_in_map.cast<double>() / voxel_size_m_ - origin;
  const double length = way.norm();
  const double end = length - ray.margin_m / voxel_size_m_;
  if (!(end > 0.0)) return true;

  int voxel[3], step[3];
  double next[3],
      interval[3];  // distance along the ray to the next boundary, and between boundaries
  for (int axis = 0; axis < 3; ++axis) {
    const double floor = std::floor(origin[axis]);
    voxel[axis] = static_cast<int>(floor) + geometry::VoxelKey::kCentre;
    const double slope = way[axis] / length;
    step[axis] = slope > 0.0 ? 1 : -1;
    interval[axis] = slope == 0.0 ? std::numeric_limits<double>::infinity() : 1.0 / std::abs(slope);
    const double to_boundary = slope > 0.0 ? floor + 1.0 - origin[axis] : origin[axis] - floor;
    next[axis] = slope == 0.0 ? interval[axis] : to_boundary * interval[axis];
  }
  Block* block = nullptr;
  int block_x = -1, block_y = -1, block_z = -1;
  for (;;) {
    if (voxel[0] >> kBlockBits != block_x || voxel[1] >> kBlockBits != block_y ||
        voxel[2] >> kBlockBits != block_z) {
      block = BlockAt(voxel[0], voxel[1], voxel[2]);
      if (!block) return false;
      block_x = voxel[0] >> kBlockBits;
      block_y = voxel[1] >> kBlockBits;
      block_z = voxel[2] >> kBlockBits;
    }
    Update(*block, voxel[0], voxel[1], voxel[2], miss_);
    const int axis = next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
    if (next[axis] >= end) return true;
    voxel[axis] += step[axis];
    next[axis] += interval[axis];
  }
}

absl::Status OccupancyGrid::InsertScan(std::span<const Ray> rays) {
  scan_ = scan_ == std::numeric_limits<std::uint16_t>::max() ? 1 : scan_ + 1;
  const absl::Status full = absl::ResourceExhaustedError(absl::StrCat(
      "the building has more than ", max_blocks_ * kBlockSize * kBlockSize * kBlockSize,
      " known voxels of ", voxel_size_m_, " m, the limit of a map"));
  const auto in_range = [&](const Ray& ray) {
    return geometry::KeyFromPoint(ray.origin_in_map.cast<double>(), voxel_size_m_) &&
           geometry::KeyFromPoint(ray.end_in_map.cast<double>(), voxel_size_m_);
  };
  for (const Ray& ray : rays) {
    if (!in_range(ray)) continue;
    const auto key = geometry::KeyFromPoint(ray.end_in_map.cast<double>(), voxel_size_m_);
    Block* block = BlockAt(key->x, key->y, key->z);
    if (!block) return full;
    Update(*block, key->x, key->y, key->z, hit_);
  }
  for (const Ray& ray : rays) {
    if (in_range(ray) && !CastFree(ray)) return full;
  }
  return absl::OkStatus();
}

std::shared_ptr<octomap::OcTree> OccupancyGrid::ToOctree() const {
  std::vector<const Block*> sorted;
  sorted.reserve(blocks_.size());
  for (const auto& block : blocks_) sorted.push_back(block.get());
  std::sort(sorted.begin(), sorted.end(),
            [](const Block* a, const Block* b) { return MortonCode(a->key) < MortonCode(b->key); });

  auto octree = std::make_shared<octomap::OcTree>(voxel_size_m_);
  for (const Block* block : sorted) {
    for (int z = 0; z < kBlockSize; ++z) {
      for (int y = 0; y < kBlockSize; ++y) {
        for (int x = 0; x < kBlockSize; ++x) {
          const Block::Cell& cell = block->cells[CellInBlock(x, y, z)];
          if (cell.scan == 0) continue;
          const octomap::OcTreeKey key((block->key.x << kBlockBits) + x,
                                       (block->key.y << kBlockBits) + y,
                                       (block->key.z << kBlockBits) + z);
          octree->setNodeValue(key,
                               cell.log_odds > 0 ? octree->getClampingThresMaxLog()
                                                 : octree->getClampingThresMinLog(),
                               /*lazy_eval=*/true);
        }
      }
    }
  }
  octree->updateInnerOccupancy();
  octree->prune();
  return octree;
}

}  // namespace soundmap::mapping
