#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "recording/ring_rays.h"

namespace soundmap::recording {

// The ring of a point at (0, 0, 0), which is none.
inline constexpr std::uint8_t kNoReturnRing = 255;

// For each point its ring and the steps of azimuth since the last point of that ring.
struct PointOrder {
  std::vector<std::uint8_t> ring;
  std::vector<std::uint8_t> steps;  // up to RingRays::kMaxSteps
  double turn_rad = 0.0;            // one step of azimuth
};

// How a spinning LIDAR took the points, told from where they lie: a guess costs bytes, not
// exactness. Not `in_rings`: one ring that does not turn.
PointOrder OrderOf(std::span<const GridPoint> points, bool in_rings);

}  // namespace soundmap::recording
