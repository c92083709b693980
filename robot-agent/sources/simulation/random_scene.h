#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"

namespace soundmap::simulation {

// The text of a scene file drawn at random: a room of 4 to 20 m with furniture and machines, RT60
// 0.2 to 0.9 s, 1 to 8 sources of all kinds within 12 dB on ceiling, walls and machines, an array
// of 8, 16 or 32 microphones in a plane or in space at any rotation, and a robot that drives past
// the sources, around what stands there; sometimes people walk about. The seed decides everything:
// seed % 3 is 0 for arrays in a plane, seed / 3 % 3 goes through 8, 16 and 32 microphones.
// Internal: no room of this seed could be driven through.
absl::StatusOr<std::string> RandomScene(std::uint64_t seed);

}  // namespace soundmap::simulation
