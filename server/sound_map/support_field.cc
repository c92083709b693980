#include "sound_map/support_field.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <optional>
#include <set>
#include <utility>

#include "sound_map/tile.h"

namespace soundmap::sound_map {
namespace {

geometry::VoxelKey BlockKeyOf(const geometry::VoxelKey& key) {
  return {static_cast<std::uint16_t>(key.x >> Block::kBits),
          static_cast<std::uint16_t>(key.y >> Block::kBits),
          static_cast<std::uint16_t>(key.z >> Block::kBits)};
}

geometry::VoxelKey Clamped(int x, int y, int z) {
  const auto part = [](int value) {
    return static_cast<std::uint16_t>(std::clamp(value, 0, 65535));
  };
  return {part(x), part(y), part(z)};
}

TileKey TileOfBlock(const geometry::VoxelKey& block) {
  constexpr int kShift = TileKey::kBits - Block::kBits;
  return {static_cast<std::uint16_t>(block.x >> kShift),
          static_cast<std::uint16_t>(block.y >> kShift),
          static_cast<std::uint16_t>(block.z >> kShift)};
}

int NumberOfBlock(const geometry::VoxelKey& block) {
  return (block.x & 3) | (block.y & 3) << 2 | (block.z & 3) << 4;
}

// The blocks of a box of voxels, in map order.
template <typename Visit>
void ForEachBlock(const geometry::VoxelKey& low, const geometry::VoxelKey& high, Visit visit) {
  const geometry::VoxelKey first = BlockKeyOf(low);
  const geometry::VoxelKey last = BlockKeyOf(high);
  for (int z = first.z; z <= last.z; ++z) {
    for (int y = first.y; y <= last.y; ++y) {
      for (int x = first.x; x <= last.x; ++x) visit(Clamped(x, y, z));
    }
  }
}

typedef float Float4 __attribute__((vector_size(16)));

Float4 LoadFloat4(const float* p) {  // of any alignment
  Float4 value;
  std::memcpy(&value, p, sizeof(value));
  return value;
}

}  // namespace

// The observations of the voxels of one block and of those that the Gaussian reaches from there, as
// a dense grid of numbers, of which most are 0.
class SupportField::Surroundings {
 public:
  static constexpr int kColumns = 12;  // in one pass

  explicit Surroundings(double sigma_voxels)
      : radius_(static_cast<int>(std::ceil(2.5 * sigma_voxels))),
        width_((1 << Block::kBits) + 2 * radius_),
        reach_((2 * radius_ + kColumns) / kColumns * kColumns),
        stride_((1 << Block::kBits) + reach_) {
    for (int k = -radius_; k <= radius_; ++k) {
      kernel_.push_back(static_cast<float>(std::exp(-0.5 * k * k / (sigma_voxels * sigma_voxels))));
    }
    kernel_.resize(reach_, 0.0f);
    for (Grid* grid : {&all_, &supporting_}) {
      grid->values.assign(static_cast<std::size_t>(width_) * width_ * stride_, 0.0f);
      grid->rows.resize(width_);
    }
  }

  void Read(const SupportField& field, const Snapshot& snapshot, const geometry::VoxelKey& block) {
    const int side = 1 << Block::kBits;
    const int x0 = block.x * side - radius_;
    const int y0 = block.y * side - radius_;
    const int z0 = block.z * side - radius_;
    all_.Clear();
    supporting_.Clear();
    const Tile* tile = nullptr;
    const auto put = [&](Grid& grid, int x, int y, int z, std::uint32_t count) {
      if ((static_cast<unsigned>(x) >= static_cast<unsigned>(width_)) |
          (static_cast<unsigned>(y) >= static_cast<unsigned>(width_)) |
          (static_cast<unsigned>(z) >= static_cast<unsigned>(width_))) {
        return;
      }
      grid.rows[z].first = std::min(grid.rows[z].first, y);
      grid.rows[z].last = std::max(grid.rows[z].last, y);
      grid.values[(z * width_ + y) * stride_ + x] = static_cast<float>(count);
    };
    ForEachBlock(
        Clamped(x0, y0, z0), Clamped(x0 + width_ - 1, y0 + width_ - 1, z0 + width_ - 1),
        [&](const geometry::VoxelKey& near) {
          const TileKey key = TileOfBlock(near);
          if (tile == nullptr || tile->key() != key) tile = snapshot.FindTile(key);
          const Block* cells = tile == nullptr ? nullptr : tile->block(NumberOfBlock(near));
          if (cells == nullptr) return;
          int rank = 0;
          for (int word = 0; word < side; ++word) {
            for (std::uint64_t rest = cells->mask()[word]; rest != 0; rest &= rest - 1, ++rank) {
              const int voxel = __builtin_ctzll(rest);
              put(all_, near.x * side + (voxel & 7) - x0, near.y * side + (voxel >> 3) - y0,
                  near.z * side + word - z0, cells->at(rank).update_count);
            }
          }
          field.ForEachInBlock(near, [&](const ObservedVoxel& voxel) {
            put(supporting_, voxel.key.x - x0, voxel.key.y - y0, voxel.key.z - z0,
                voxel.support.count);
          });
        });
  }

  // Around a voxel of the block.
  Counts At(const geometry::VoxelKey& key) const {
    return {Sum(supporting_, key.x & 7, key.y & 7, key.z & 7),
            Sum(all_, key.x & 7, key.y & 7, key.z & 7)};
  }

 private:
  struct Rows {
    int first = 0;
    int last = 0;
  };
  struct Grid {
    void Clear() {
      std::fill(values.begin(), values.end(), 0.0f);
      std::fill(rows.begin(), rows.end(), Rows{1 << 20, -1});
    }
    std::vector<float> values;  // x fastest; rows are stride_ apart
    std::vector<Rows> rows;     // of each z: outside of these y all is 0
  };

  // Some columns at a time: down the rows by the Gaussian of y and z, then across by that of x.
  double Sum(const Grid& grid, int x, int y, int z) const {
    double sum = 0.0;
    for (int left = 0; left < reach_; left += kColumns) {
      Float4 a = {}, b = {}, c = {};  // side by side, so that no addition waits for the one before
      for (int dz = 0; dz <= 2 * radius_; ++dz) {
        const Rows& rows = grid.rows[z + dz];
        const int first = std::max(rows.first - y, 0);
        const int last = std::min(rows.last - y, 2 * radius_);
        if (last < first) continue;
        const float* row = &grid.values[((z + dz) * width_ + y + first) * stride_ + x + left];
        for (int dy = first; dy <= last; ++dy, row += stride_) {
          const float weight = kernel_[dz] * kernel_[dy];
          a += weight * LoadFloat4(row);
          b += weight * LoadFloat4(row + 4);
          c += weight * LoadFloat4(row + 8);
        }
      }
      for (int i = 0; i < 4; ++i) {
        sum += static_cast<double>(a[i]) * kernel_[left + i] +
               static_cast<double>(b[i]) * kernel_[left + 4 + i] +
               static_cast<double>(c[i]) * kernel_[left + 8 + i];
      }
    }
    return sum;
  }

  const int radius_;
  const int width_;
  const int reach_;  // columns under the Gaussian, in whole passes
  const int stride_;
  std::vector<float> kernel_;
  Grid all_;
  Grid supporting_;
};

SupportField::SupportField(double sigma_m, std::uint32_t min_updates, int max_voxels)
    : sigma_m_(sigma_m), min_updates_(min_updates), max_voxels_(max_voxels) {}

void SupportField::Read(const Tile& tile, TileSupport& support) const {
  support.revision = tile.revision();
  support.voxels.clear();
  std::vector<std::pair<std::uint16_t, Support>> heard(tile.support().begin(),
                                                       tile.support().end());
  std::sort(heard.begin(), heard.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });
  for (const auto& [number, of_voxel] : heard) {
    const geometry::VoxelKey key = tile.KeyOf(number / Block::kVoxels, number % Block::kVoxels);
    const std::optional<Voxel> voxel = tile.Find(key);
    if (voxel && voxel->update_count > min_updates_) {
      support.voxels.push_back({key, *voxel, of_voxel});
    }
  }
}

std::vector<TileKey> SupportField::Follow(const Snapshot& snapshot) {
  voxel_size_m_ = snapshot.voxel_size_m();
  std::vector<TileKey> changed;
  auto known = tiles_.begin();
  const auto forget_before = [&](const TileKey* key) {
    while (known != tiles_.end() && (key == nullptr || known->first < *key)) {
      changed.push_back(known->first);
      known = tiles_.erase(known);
    }
  };
  for (const auto& tile : snapshot.tiles()) {
    const TileKey key = tile->key();
    forget_before(&key);
    const bool is_new = known == tiles_.end() || known->first != key;
    if (is_new) known = tiles_.emplace_hint(known, key, TileSupport{});
    if (is_new || known->second.revision != tile->revision()) {
      Read(*tile, known->second);
      changed.push_back(key);
    }
    ++known;
  }
  forget_before(nullptr);

  std::set<TileKey> affected;
  const std::uint32_t least_count = LeastCount();
  if (std::exchange(least_count_, least_count) != least_count) {
    for (const auto& [key, support] : tiles_) affected.insert(key);
    affected.insert(changed.begin(), changed.end());
    return {affected.begin(), affected.end()};
  }
  // The Gaussian reaches from a tile into those beside it.
  for (const TileKey& key : changed) {
    for (int offset = 0; offset < 27; ++offset) {
      affected.insert({static_cast<std::uint16_t>(key.x + offset % 3 - 1),
                       static_cast<std::uint16_t>(key.y + offset / 3 % 3 - 1),
                       static_cast<std::uint16_t>(key.z + offset / 9 - 1)});
    }
  }
  return {affected.begin(), affected.end()};
}

std::uint32_t SupportField::LeastCount() const {
  std::size_t size = 0;
  for (const auto& [key, support] : tiles_) size += support.voxels.size();
  if (size <= static_cast<std::size_t>(max_voxels_)) return 1;
  std::vector<std::uint32_t> counts;
  counts.reserve(size);
  for (const auto& [key, support] : tiles_) {
    for (const ObservedVoxel& voxel : support.voxels) counts.push_back(voxel.support.count);
  }
  const auto first_left_out = counts.begin() + max_voxels_;
  std::nth_element(counts.begin(), first_left_out, counts.end(), std::greater<>());
  return *first_left_out == UINT32_MAX ? UINT32_MAX : *first_left_out + 1;
}

void SupportField::ForEachInBlock(const geometry::VoxelKey& block,
                                  absl::FunctionRef<void(const ObservedVoxel&)> visit) const {
  const auto tile = tiles_.find(TileOfBlock(block));
  if (tile == tiles_.end()) return;
  const std::vector<ObservedVoxel>& voxels = tile->second.voxels;
  const int number = NumberOfBlock(block);
  const auto first = std::partition_point(
      voxels.begin(), voxels.end(),
      [number](const ObservedVoxel& voxel) { return Tile::BlockOf(voxel.key) < number; });
  for (auto voxel = first; voxel != voxels.end() && Tile::BlockOf(voxel->key) == number; ++voxel) {
    if (voxel->support.count >= least_count_) visit(*voxel);
  }
}

std::vector<const ObservedVoxel*> SupportField::Around(const Eigen::Vector3d& point_in_map,
                                                       double radius_m) const {
  std::vector<const ObservedVoxel*> found;
  const auto low = geometry::KeyFromPoint(point_in_map.array() - radius_m, voxel_size_m());
  const auto high = geometry::KeyFromPoint(point_in_map.array() + radius_m, voxel_size_m());
  if (!low || !high) return found;
  ForEachBlock(*low, *high, [&](const geometry::VoxelKey& block) {
    ForEachInBlock(block, [&](const ObservedVoxel& voxel) {
      const Eigen::Vector3d centre = geometry::PointFromKey(voxel.key, voxel_size_m());
      if ((centre - point_in_map).norm() <= radius_m) found.push_back(&voxel);
    });
  });
  return found;
}

void SupportField::ForEachCount(
    const Snapshot& snapshot, const TileKey& tile, double min_share,
    absl::FunctionRef<void(const ObservedVoxel&, const Counts&)> visit) const {
  const auto support = tiles_.find(tile);
  if (support == tiles_.end()) return;
  std::optional<Surroundings> surroundings;
  std::optional<geometry::VoxelKey> read;
  for (const ObservedVoxel& voxel : support->second.voxels) {
    const bool stands_out = voxel.support.count > 1 &&
                            voxel.support.count > min_share * voxel.fields.update_count &&
                            voxel.support.count >= least_count_;
    if (!stands_out) continue;
    if (!surroundings) surroundings.emplace(std::min(sigma_m_ / voxel_size_m_, kMaxSigma_voxels));
    const geometry::VoxelKey block = BlockKeyOf(voxel.key);
    if (read != block) {
      surroundings->Read(*this, snapshot, block);
      read = block;
    }
    visit(voxel, surroundings->At(voxel.key));
  }
}

}  // namespace soundmap::sound_map
