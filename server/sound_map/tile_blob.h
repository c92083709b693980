#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "sound_map/voxel.h"

namespace soundmap::sound_map {

class Tile;

// A tile as it is stored: opaque to everyone else.
struct TileBlob {
  TileKey key;
  std::string bytes;

  bool operator==(const TileBlob&) const = default;
};

// The blob, version 1, little-endian:
//   "SMTL", u16 version, u16 zero, u32 CRC32C of all that follows, u32 bytes of the payload before
//   compression, then the payload, zstd.
// Payload:
//   f64 voxel size [m], u16 x, y, z of the tile, u16 zero, u64 revision, u64 mask of the blocks
//   that exist, for each of these 8 u64: mask of its voxels (word z, bit x + 8 y); V is the number
//   of voxels; V f32 log-odds, V u32 update counts, u32 T, T i64 last-update times ascending, V u16
//   indices of them, u32 S, S u16 numbers of voxels with support ascending (block * 512 + voxel), S
//   i64 first heard, S i64 last heard, S u32 counts.
// Voxels stand in map order. The same voxels and revision give the same bytes.
std::string SerializeTile(const Tile& tile, double voxel_size_m);

// DataLoss: damaged. InvalidArgument: of a newer version, for another tile or another voxel size.
// Memory stays below 4 MiB whatever the bytes.
absl::StatusOr<std::shared_ptr<Tile>> ParseTile(const TileBlob& blob, double voxel_size_m);

}  // namespace soundmap::sound_map
