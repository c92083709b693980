#pragma once

#include <algorithm>
#include <random>
#include <vector>

#include "sound_map/evidence.h"

namespace soundmap::sound_map {

// Scans around the centre of the octree, across several tiles, with voxels that come again and now
// and then a scan that is late.
inline std::vector<EvidenceScan> RandomScans(int count, int end_points, std::uint64_t seed,
                                             std::vector<float> likelihoods = {0.1f, 0.5f, 0.9f,
                                                                               0.999f}) {
  std::mt19937_64 random(seed);
  std::uniform_int_distribution<int> part(32768 - 70, 32768 + 70);
  std::uniform_int_distribution<int> height(32768, 32768 + 5);
  std::uniform_int_distribution<std::size_t> kind(0, likelihoods.size() - 1);
  std::vector<EvidenceScan> scans(count);
  frames::TimeNs stamp_ns = 1'700'000'000'123'456'789;
  for (EvidenceScan& scan : scans) {
    stamp_ns += 137'500'001;
    scan.stamp_ns = random() % 5 == 0 ? stamp_ns - 1'000'000'000 : stamp_ns;
    for (int i = 0; i < end_points; ++i) {
      scan.end_points.push_back(
          {{static_cast<std::uint16_t>(part(random) / 4 * 4),
            static_cast<std::uint16_t>(part(random)), static_cast<std::uint16_t>(height(random))},
           likelihoods[kind(random)]});
    }
  }
  return scans;
}

}  // namespace soundmap::sound_map
