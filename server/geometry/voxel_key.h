#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>

namespace soundmap::geometry {

// OctoMap's key at the lowest of its 16 levels: voxel k spans [(k - 32768) * size, (k - 32767) *
// size) on its axis.
struct VoxelKey {
  static constexpr int kCentre = 32768;

  std::uint16_t x = 0;
  std::uint16_t y = 0;
  std::uint16_t z = 0;

  auto operator<=>(const VoxelKey&) const = default;
};

// None outside the octree (about +-1638 m at 0.05 m) and for a point that is not finite.
inline std::optional<VoxelKey> KeyFromPoint(const Eigen::Vector3d& point_in_map,
                                            double voxel_size_m) {
  std::uint16_t axis[3];
  for (int i = 0; i < 3; ++i) {
    const double index = std::floor(point_in_map[i] / voxel_size_m) + VoxelKey::kCentre;
    if (!(index >= 0.0 && index <= 65535.0)) return std::nullopt;
    axis[i] = static_cast<std::uint16_t>(index);
  }
  return VoxelKey{axis[0], axis[1], axis[2]};
}

// Centre of the voxel.
inline Eigen::Vector3d PointFromKey(const VoxelKey& key, double voxel_size_m) {
  return (Eigen::Vector3d(key.x, key.y, key.z) +
          Eigen::Vector3d::Constant(0.5 - VoxelKey::kCentre)) *
         voxel_size_m;
}

}  // namespace soundmap::geometry

template <>
struct std::hash<soundmap::geometry::VoxelKey> {
  std::size_t operator()(const soundmap::geometry::VoxelKey& key) const noexcept {
    std::uint64_t packed = (std::uint64_t{key.x} << 32) | (std::uint64_t{key.y} << 16) | key.z;
    packed *= 0x9e3779b97f4a7c15u;
    return packed ^ (packed >> 32);
  }
};
