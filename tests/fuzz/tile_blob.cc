#include "sound_map/tile_blob.h"

#include <isa-l/crc.h>
#include <zstd.h>

#include <cstring>

#include "sound_map/sound_map.h"
#include "tests/fuzz/target.h"

namespace soundmap::fuzz {
namespace {

constexpr double kVoxelSize_m = 0.05;
constexpr sound_map::TileKey kTile{1024, 1024, 1024};
constexpr std::size_t kHeaderBytes = 16;

// CRC-32C with the usual inversions.
std::uint32_t Crc(std::string_view bytes) {
  auto* const data = reinterpret_cast<unsigned char*>(const_cast<char*>(bytes.data()));
  return ~crc32_iscsi(data, static_cast<int>(bytes.size()), ~0u);
}

void Append(std::uint32_t value, std::string& out) {
  out.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// A blob around a payload, so that damage is not told by the checksum alone.
std::string Wrap(std::string_view payload) {
  std::string checked;
  Append(static_cast<std::uint32_t>(payload.size()), checked);
  std::string packed(ZSTD_compressBound(payload.size()), '\0');
  packed.resize(ZSTD_compress(packed.data(), packed.size(), payload.data(), payload.size(), 1));
  checked += packed;
  std::string blob("SMTL\1\0\0\0", 8);
  Append(Crc(checked), blob);
  return blob + checked;
}

}  // namespace

// The payloads of tiles.
std::vector<std::string> Seeds() {
  std::vector<std::string> seeds;
  const auto map = sound_map::SoundMap::Create(sound_map::DefaultConfig()).value();
  for (int scan = 0; scan < 20; ++scan) {
    sound_map::EvidenceScan evidence;
    evidence.stamp_ns = 1'700'000'000'000'000'000 + scan;
    for (int i = 0; i < 40; ++i) {
      evidence.end_points.push_back({{static_cast<std::uint16_t>(32768 + (i * scan) % 32),
                                      static_cast<std::uint16_t>(32768 + i % 32), 32770},
                                     i % 3 == 0 ? 0.9f : 0.3f});
    }
    Require(map->Apply(evidence).ok());
    if (scan % 10 != 9) continue;
    for (const sound_map::TileBlob& blob : map->TakeDirtyTiles()) {
      std::uint32_t bytes = 0;
      std::memcpy(&bytes, blob.bytes.data() + 12, sizeof(bytes));
      std::string payload(bytes, '\0');
      Require(ZSTD_decompress(payload.data(), bytes, blob.bytes.data() + kHeaderBytes,
                              blob.bytes.size() - kHeaderBytes) == bytes);
      seeds.push_back(std::move(payload));
    }
  }
  Require(!seeds.empty());
  // So the wrapping is the format's own.
  Require(sound_map::ParseTile({kTile, Wrap(seeds.front())}, kVoxelSize_m).ok());
  return seeds;
}

void Decode(std::string_view bytes) {
  (void)sound_map::ParseTile({kTile, std::string(bytes)}, kVoxelSize_m);
  const auto tile = sound_map::ParseTile({kTile, Wrap(bytes)}, kVoxelSize_m);
  if (!tile.ok()) return;
  const std::string again = SerializeTile(**tile, kVoxelSize_m);
  Require(sound_map::ParseTile({kTile, again}, kVoxelSize_m).ok());
}

}  // namespace soundmap::fuzz
