#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "building/building.h"

namespace soundmap::building {

// A building as bytes to store, and back without loss. Equal buildings give equal bytes.
// Layout, little-endian: "SMBUILDG", u32 version (1), u32 0, then one zstd frame with its checksum
// of: u64 length of the octree and the octree as `.ot` (length 0: none), i32 width, i32 height, f64
// cell_size_m, f64 origin x, f64 origin y, and the cells, a byte each (building::Cell).
std::string SerializeBuilding(const Building& building);

// Unimplemented: a newer version. DataLoss: damaged.
absl::StatusOr<Building> ParseBuilding(std::string_view bytes);

}  // namespace soundmap::building
