#pragma once

#include <cstdint>
#include <iosfwd>

#include "absl/status/status.h"
#include "sound_map/snapshot.h"

namespace soundmap::sound_map {

// Files of the sound map for other programs. Each holds the voxels with M > min_updates (epsilon_C
// of section V), in map order where the format has an order. Unavailable when the stream fails;
// Internal when OctoMap refuses.

// .ot of OctoMap's own OcTree with L as log-odds.
absl::Status WriteOcTree(const Snapshot& snapshot, std::uint32_t min_updates, std::ostream& stream);

// .ot of SoundOcTree: L, M and U.
absl::Status WriteSoundOcTree(const Snapshot& snapshot, std::uint32_t min_updates,
                              std::ostream& stream);

// .bt: section V's occupied voxels, M > epsilon_C, whatever their L.
absl::Status WriteOccupancy(const Snapshot& snapshot, std::uint32_t min_updates,
                            std::ostream& stream);

// Binary PLY: x, y, z [m] of the voxel's centre in `map`, log_odds, update_count, last_update_s
// (double, seconds since the Unix epoch; PLY has no 64-bit integer), red, green, blue as in the
// plan view.
absl::Status WritePly(const Snapshot& snapshot, std::uint32_t min_updates, std::ostream& stream);

// Binary PCD 0.7: x, y, z, log_odds, update_count, last_update_ns (int64).
absl::Status WritePcd(const Snapshot& snapshot, std::uint32_t min_updates, std::ostream& stream);

}  // namespace soundmap::sound_map
