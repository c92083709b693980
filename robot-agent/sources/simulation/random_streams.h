#pragma once

#include <cstdint>
#include <random>

namespace soundmap::simulation {

// Independent random engines of one scene, so that a change of one sensor leaves the others' noise
// as it was.
enum class RandomStream : std::uint32_t { kSound, kTail, kMicrophones, kLidar, kLaser, kOdometry };

inline std::mt19937_64 MakeEngine(std::uint64_t seed, RandomStream stream,
                                  std::uint32_t index = 0) {
  std::seed_seq sequence{static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32),
                         static_cast<std::uint32_t>(stream), index};
  return std::mt19937_64(sequence);
}

}  // namespace soundmap::simulation
