#include "mapping/occupancy_grid.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"

namespace soundmap::mapping {
namespace {

constexpr int kBlockBits = 3;
constexpr int kBlockSize = 1 << kBlockBits;
constexpr int kLayerCells = kBlockSize * kBlockSize;
constexpr double kStep_log_odds = 1e-3;
// OctoMap's lower limit: what another map knows to be free.
constexpr double kKnownFree_log_odds = -2.0;

// Two rays of a scan that have passed through so many of the same voxels in a row stay together up
// to the LIDAR: the rest of the way is marked already, but for a few voxels that the one touches
// and the other does not. That halves the work.
constexpr int kTogether_voxels = 3;

// A voxel's size, and more than any way, in fixed point.
constexpr double kFixedOne = 1099511627776.0;        // 2^40
constexpr double kFixedMax = 1152921504606846976.0;  // 2^60

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
  // One bit a voxel, a cache line in all: rays leave their marks here, which are counted once a
  // scan.
  struct Marks {
    alignas(64) std::array<std::uint64_t, kBlockSize> layer{};  // by z

    void Set(int cell) { layer[cell / kLayerCells] |= std::uint64_t{1} << (cell % kLayerCells); }
    // Whether it was set before.
    bool Mark(int cell) {
      std::uint64_t& bits = layer[cell / kLayerCells];
      const std::uint64_t bit = std::uint64_t{1} << (cell % kLayerCells);
      const bool before = (bits & bit) != 0;
      bits |= bit;
      return before;
    }
    bool Has(int cell) const {
      return (layer[cell / kLayerCells] >> (cell % kLayerCells) & 1) != 0;
    }
  };

  Marks missed, hit;       // by the present scan
  Marks known;             // hit or missed by any
  geometry::VoxelKey key;  // of the block: voxel key / 8
  bool touched = false;    // by the present scan
  // Through its faces, the lower and the upper one of each axis, as far as rays have passed there.
  std::array<Block*, 6> next{};
  std::array<std::int16_t, kBlockSize * kLayerCells> log_odds{};
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

OccupancyGrid::Block* OccupancyGrid::Touch(Block* block) {
  if (block && !block->touched) {
    block->touched = true;
    touched_.push_back(block);
  }
  return block;
}

void OccupancyGrid::CountMarks() {
  for (Block* block : touched_) {
    block->touched = false;
    for (int z = 0; z < kBlockSize; ++z) {
      const std::uint64_t hit = block->hit.layer[z];
      const std::uint64_t missed = block->missed.layer[z] & ~hit;
      block->hit.layer[z] = block->missed.layer[z] = 0;
      block->known.layer[z] |= hit | missed;
      std::int16_t* log_odds = &block->log_odds[z * kLayerCells];
      for (std::uint64_t rest = hit; rest != 0; rest &= rest - 1) {
        std::int16_t& value = log_odds[std::countr_zero(rest)];
        value = static_cast<std::int16_t>(std::min(value + hit_, max_));
      }
      for (std::uint64_t rest = missed; rest != 0; rest &= rest - 1) {
        std::int16_t& value = log_odds[std::countr_zero(rest)];
        value = static_cast<std::int16_t>(std::max(value + miss_, min_));
      }
    }
  }
  touched_.clear();
}

// Marks the voxels on the way as missed, from the end to the origin, by exact traversal (Amanatides
// and Woo), as long as no other ray of the scan has done so. False when the map is full.
bool OccupancyGrid::CastFree(const Ray& ray) {
  const Eigen::Vector3d origin = ray.origin_in_map.cast<double>() / voxel_size_m_;
  const Eigen::Vector3d back = origin - ray.end_in_map.cast<double>() / voxel_size_m_;
  const double whole = back.norm();
  const double length = whole - ray.margin_m / voxel_size_m_;
  if (!(length > 0.0)) return true;
  const Eigen::Vector3d direction = back / whole;
  const Eigen::Vector3d begin = origin - length * direction;

  // Distances along the ray in fixed point, to the next boundary on each axis and between
  // boundaries: the choice of the next axis takes no branch, which could not be predicted.
  const auto fixed = [](double voxels) {
    return static_cast<std::int64_t>(std::min(voxels * kFixedOne, kFixedMax));
  };
  const std::int64_t length_fixed = fixed(length);
  int voxel[3], step[3];
  std::int64_t first[3], interval[3];
  for (int axis = 0; axis < 3; ++axis) {
    const double floor = std::floor(begin[axis]);
    voxel[axis] = static_cast<int>(floor) + geometry::VoxelKey::kCentre;
    const double slope = direction[axis];
    step[axis] = slope > 0.0 ? 1 : -1;
    const double to_boundary = slope > 0.0 ? floor + 1.0 - begin[axis] : begin[axis] - floor;
    interval[axis] = slope == 0.0 ? fixed(kFixedMax) : fixed(1.0 / std::abs(slope));
    first[axis] = slope == 0.0 ? interval[axis] : fixed(to_boundary / std::abs(slope));
  }
  int x = voxel[0], y = voxel[1], z = voxel[2];
  std::int64_t next_x = first[0], next_y = first[1], next_z = first[2];
  Block* block = nullptr;
  int block_x = 0, block_y = 0, block_z = 0;  // of any voxel in it
  int together = 0;                           // voxels in a row that other rays have passed
  for (;;) {
    const int out_x = (x ^ block_x) >> kBlockBits, out_y = (y ^ block_y) >> kBlockBits,
              out_z = (z ^ block_z) >> kBlockBits;
    if (!block || (out_x | out_y | out_z) != 0) {
      if (block) {
        const int axis = out_x != 0 ? 0 : out_y != 0 ? 1 : 2;
        Block*& next = block->next[2 * axis + (step[axis] > 0)];
        if (!next) next = BlockAt(x, y, z);
        block = Touch(next);
      } else {
        block = Touch(BlockAt(x, y, z));
      }
      if (!block) return false;
      block_x = x;
      block_y = y;
      block_z = z;
    }
    together = block->missed.Mark(CellInBlock(x, y, z)) ? together + 1 : 0;
    if (together == kTogether_voxels) return true;
    const bool is_x = (next_x <= next_y) & (next_x <= next_z);
    const bool is_y = !is_x & (next_y <= next_z);
    const bool is_z = !(is_x | is_y);
    if (std::min(std::min(next_x, next_y), next_z) >= length_fixed) return true;
    x += step[0] & -static_cast<int>(is_x);
    y += step[1] & -static_cast<int>(is_y);
    z += step[2] & -static_cast<int>(is_z);
    next_x += interval[0] & -static_cast<std::int64_t>(is_x);
    next_y += interval[1] & -static_cast<std::int64_t>(is_y);
    next_z += interval[2] & -static_cast<std::int64_t>(is_z);
  }
}

absl::Status OccupancyGrid::Full() const {
  return absl::ResourceExhaustedError(absl::StrCat(
      "the building has more than ", max_blocks_ * kBlockSize * kBlockSize * kBlockSize,
      " known voxels of ", voxel_size_m_, " m, the limit of a map"));
}

absl::Status OccupancyGrid::InsertKnown(const octomap::OcTree& octree) {
  const int free = std::max(min_, Steps(kKnownFree_log_odds));
  // Free ones first: an occupied leaf smaller than a voxel makes it occupied.
  for (const bool occupied : {false, true}) {
    for (auto leaf = octree.begin_leafs(), end = octree.end_leafs(); leaf != end; ++leaf) {
      if (octree.isNodeOccupied(*leaf) != occupied) continue;
      // The voxels whose centres lie in the leaf; at least the one around the leaf's own.
      const double half_m = 0.5 * leaf.getSize();
      const Eigen::Vector3d centre(leaf.getX(), leaf.getY(), leaf.getZ());
      int first[3], last[3];
      for (int axis = 0; axis < 3; ++axis) {
        const double from = (centre[axis] - half_m) / voxel_size_m_ - 0.5;
        const double to = (centre[axis] + half_m) / voxel_size_m_ - 0.5;
        // Voxel sizes that divide each other must not lose or double a voxel to rounding.
        first[axis] = static_cast<int>(std::ceil(from - 1e-3));
        last[axis] = static_cast<int>(std::ceil(to - 1e-3)) - 1;
        if (last[axis] < first[axis]) {
          first[axis] = last[axis] = static_cast<int>(std::floor(centre[axis] / voxel_size_m_));
        }
        first[axis] = std::max(first[axis] + geometry::VoxelKey::kCentre, 0);
        last[axis] = std::min(last[axis] + geometry::VoxelKey::kCentre, 65535);
      }
      for (int z = first[2]; z <= last[2]; ++z) {
        for (int y = first[1]; y <= last[1]; ++y) {
          for (int x = first[0]; x <= last[0]; ++x) {
            Block* block = BlockAt(x, y, z);
            if (!block) return Full();
            const int cell = CellInBlock(x, y, z);
            block->known.Set(cell);
            block->log_odds[cell] = static_cast<std::int16_t>(occupied ? max_ : free);
          }
        }
      }
    }
  }
  return absl::OkStatus();
}

absl::Status OccupancyGrid::InsertScan(std::span<const Ray> rays) {
  const absl::Status status = MarkScan(rays);
  CountMarks();
  return status;
}

absl::Status OccupancyGrid::MarkScan(std::span<const Ray> rays) {
  for (const Ray& ray : rays) {
    if (!geometry::KeyFromPoint(ray.origin_in_map.cast<double>(), voxel_size_m_)) continue;
    const auto key = geometry::KeyFromPoint(ray.end_in_map.cast<double>(), voxel_size_m_);
    if (!key) continue;
    Block* block = Touch(BlockAt(key->x, key->y, key->z));
    if (!block) return Full();
    block->hit.Set(CellInBlock(key->x, key->y, key->z));
    if (!CastFree(ray)) return Full();
  }
  return absl::OkStatus();
}

absl::Status OccupancyGrid::FillSeenThrough(std::span<const Ray> rays) {
  constexpr double kStep_voxels = 0.5;
  for (const Ray& ray : rays) {
    const Eigen::Vector3d origin = ray.origin_in_map.cast<double>();
    const Eigen::Vector3d way = ray.end_in_map.cast<double>() - origin;
    const double length_m = way.norm() - ray.margin_m;
    for (double at_m = 0.0; at_m <= length_m; at_m += kStep_voxels * voxel_size_m_) {
      const auto key = geometry::KeyFromPoint(origin + at_m / way.norm() * way, voxel_size_m_);
      if (!key) break;
      Block* block = BlockAt(key->x, key->y, key->z);
      if (!block) return Full();
      const int cell = CellInBlock(key->x, key->y, key->z);
      if (block->log_odds[cell] > 0) break;
      if (block->known.Has(cell)) continue;
      block->known.Set(cell);
      block->log_odds[cell] = static_cast<std::int16_t>(std::max(miss_, min_));
    }
  }
  return absl::OkStatus();
}

// Hit by hardly more than one scan, seen through by others and alone: what is left of something
// that moved.
bool OccupancyGrid::IsSpeckle(const Block& block, int x, int y, int z) const {
  const int log_odds = block.log_odds[CellInBlock(x, y, z)];
  const bool seen_through = log_odds % hit_ != 0;
  if (log_odds >= 2 * hit_ || !seen_through) return false;
  const int centre[3] = {(block.key.x << kBlockBits) + x, (block.key.y << kBlockBits) + y,
                         (block.key.z << kBlockBits) + z};
  for (int dx = -1; dx <= 1; ++dx) {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dz = -1; dz <= 1; ++dz) {
        if (dx == 0 && dy == 0 && dz == 0) continue;
        const int other[3] = {centre[0] + dx, centre[1] + dy, centre[2] + dz};
        const auto found = block_index_.find({static_cast<std::uint16_t>(other[0] >> kBlockBits),
                                              static_cast<std::uint16_t>(other[1] >> kBlockBits),
                                              static_cast<std::uint16_t>(other[2] >> kBlockBits)});
        if (found == block_index_.end()) continue;
        const Block& there = *blocks_[found->second];
        if (there.log_odds[CellInBlock(other[0], other[1], other[2])] > 0) return false;
      }
    }
  }
  return true;
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
          const int cell = CellInBlock(x, y, z);
          if (!block->known.Has(cell)) continue;
          const octomap::OcTreeKey key((block->key.x << kBlockBits) + x,
                                       (block->key.y << kBlockBits) + y,
                                       (block->key.z << kBlockBits) + z);
          const bool occupied = block->log_odds[cell] > 0 && !IsSpeckle(*block, x, y, z);
          octree->setNodeValue(
              key, occupied ? octree->getClampingThresMaxLog() : octree->getClampingThresMinLog(),
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
