#pragma once

#include <cmath>
#include <cstdint>
#include <functional>

#include "frames/frames.h"
#include "geometry/voxel_key.h"

namespace soundmap::sound_map {

// The three fields of section V. A voxel exists once it has been updated.
struct Voxel {
  float log_odds = 0.0f;              // L
  std::uint32_t update_count = 0;     // M
  frames::TimeNs last_update_ns = 0;  // U: the latest t_k; a late scan does not move it back

  bool operator==(const Voxel&) const = default;
};

// The observations of one voxel that spoke for a source (likelihood > 0.5).
struct Support {
  frames::TimeNs first_heard_ns = 0;
  frames::TimeNs last_heard_ns = 0;
  std::uint32_t count = 0;

  bool operator==(const Support&) const = default;
};

inline double ProbabilityFromLogOdds(double log_odds) { return 1.0 / (1.0 + std::exp(-log_odds)); }

// A cube of 32^3 voxels, one octree node of depth 11: the unit on disk.
struct TileKey {
  static constexpr int kBits = 5;

  std::uint16_t x = 0;  // 0 .. 2047
  std::uint16_t y = 0;
  std::uint16_t z = 0;

  auto operator<=>(const TileKey&) const = default;
};

inline TileKey TileOf(const geometry::VoxelKey& key) {
  return {static_cast<std::uint16_t>(key.x >> TileKey::kBits),
          static_cast<std::uint16_t>(key.y >> TileKey::kBits),
          static_cast<std::uint16_t>(key.z >> TileKey::kBits)};
}

}  // namespace soundmap::sound_map
