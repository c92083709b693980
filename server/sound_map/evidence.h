#pragma once

#include <vector>

#include "frames/frames.h"
#include "geometry/voxel_key.h"

namespace soundmap::sound_map {

// One ray of section V: the voxel in which it ends, and the likelihood L(theta_i, phi_i, k) that it
// carries there.
struct EndPoint {
  geometry::VoxelKey key;
  float likelihood = 0.5f;

  bool operator==(const EndPoint&) const = default;
};

// The evidence of one audio scan, in the order in which it is applied.
struct EvidenceScan {
  frames::TimeNs stamp_ns = 0;  // t_k: capture time of the middle of the scan
  std::vector<EndPoint> end_points;
  // Where the local maxima of the scan's power end: for the source register alone, the voxels are
  // not told. Empty: not known.
  std::vector<geometry::VoxelKey> maxima;

  bool operator==(const EvidenceScan&) const = default;
};

}  // namespace soundmap::sound_map
