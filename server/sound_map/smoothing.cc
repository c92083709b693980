#include "sound_map/smoothing.h"

#include <algorithm>
#include <cmath>

namespace soundmap::sound_map {
namespace {

constexpr int kBlock = 8;

// A cube of side^3 numbers, x fastest.
class Cube {
 public:
  explicit Cube(int side) : side_(side), values_(static_cast<std::size_t>(side) * side * side) {}
  void Clear() { std::fill(values_.begin(), values_.end(), 0.0f); }
  float& at(int x, int y, int z) {
    return values_[(static_cast<std::size_t>(z) * side_ + y) * side_ + x];
  }
  const float* row(int y, int z) const {
    return &values_[(static_cast<std::size_t>(z) * side_ + y) * side_];
  }

 private:
  int side_;
  std::vector<float> values_;
};

// The Gaussian along x, then y, then z; only the kBlock^3 voxels in the middle come out, at the front of the cube.
void Smooth(std::span<const float> kernel, int side, Cube& cube) {
  const int taps = static_cast<int>(kernel.size());
  float line[64];
  for (int z = 0; z < side; ++z) {
    for (int y = 0; y < side; ++y) {
      const float* row = cube.row(y, z);
      for (int x = 0; x < kBlock; ++x) {
        float sum = 0.0f;
        for (int k = 0; k < taps; ++k) sum += kernel[k] * row[x + k];
        line[x] = sum;
      }
      for (int x = 0; x < kBlock; ++x) cube.at(x, y, z) = line[x];
    }
  }
  for (int z = 0; z < side; ++z) {
    for (int y = 0; y < kBlock; ++y) {
      std::fill(line, line + kBlock, 0.0f);
      for (int k = 0; k < taps; ++k) {
        const float* row = cube.row(y + k, z);
        for (int x = 0; x < kBlock; ++x) line[x] += kernel[k] * row[x];
      }
      // Rows below y + 1 are not read again.
      for (int x = 0; x < kBlock; ++x) cube.at(x, y, z) = line[x];
    }
  }
  for (int z = 0; z < kBlock; ++z) {
    for (int y = 0; y < kBlock; ++y) {
      std::fill(line, line + kBlock, 0.0f);
      for (int k = 0; k < taps; ++k) {
        const float* row = cube.row(y, z + k);
        for (int x = 0; x < kBlock; ++x) line[x] += kernel[k] * row[x];
      }
      for (int x = 0; x < kBlock; ++x) cube.at(x, y, z) = line[x];
    }
  }
}

}  // namespace

std::vector<float> SmoothLogOdds(const Snapshot& snapshot, std::span<const geometry::VoxelKey> keys,
                                 double sigma_voxels) {
  const int radius = std::max(1, static_cast<int>(std::ceil(2.5 * sigma_voxels)));
  const int side = kBlock + 2 * radius;
  std::vector<float> kernel;
  for (int k = -radius; k <= radius; ++k) {
    kernel.push_back(static_cast<float>(std::exp(-0.5 * k * k / (sigma_voxels * sigma_voxels))));
  }
  Cube sum(side);
  Cube weight(side);
  std::vector<float> smooth(keys.size(), 0.0f);
  for (std::size_t begin = 0, end = 0; begin < keys.size(); begin = end) {
    const geometry::VoxelKey& first = keys[begin];
    const int corner[3] = {(first.x & ~7) - radius, (first.y & ~7) - radius, (first.z & ~7) - radius};
    const auto same_block = [&](const geometry::VoxelKey& key) {
      return key.x >> 3 == first.x >> 3 && key.y >> 3 == first.y >> 3 && key.z >> 3 == first.z >> 3;
    };
    while (end < keys.size() && same_block(keys[end])) ++end;

    const auto clamped = [&](int axis, int offset) {
      return static_cast<std::uint16_t>(std::clamp(corner[axis] + offset, 0, 65535));
    };
    sum.Clear();
    weight.Clear();
    snapshot.ForEachInBox({clamped(0, 0), clamped(1, 0), clamped(2, 0)},
                          {clamped(0, side - 1), clamped(1, side - 1), clamped(2, side - 1)},
                          [&](const geometry::VoxelKey& key, const Voxel& voxel) {
                            const int x = key.x - corner[0];
                            const int y = key.y - corner[1];
                            const int z = key.z - corner[2];
                            sum.at(x, y, z) = voxel.log_odds;
                            weight.at(x, y, z) = 1.0f;
                            return true;
                          });
    Smooth(kernel, side, sum);
    Smooth(kernel, side, weight);
    for (std::size_t i = begin; i < end; ++i) {
      const int x = keys[i].x & 7;
      const int y = keys[i].y & 7;
      const int z = keys[i].z & 7;
      smooth[i] = sum.at(x, y, z) / weight.at(x, y, z);
    }
  }
  return smooth;
}

}  // namespace soundmap::sound_map
