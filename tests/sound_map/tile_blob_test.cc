#include "sound_map/tile_blob.h"

#include <gtest/gtest.h>

#include <cstring>

#include "sound_map/sound_map.h"
#include "sound_map/tile.h"
#include "tests/sound_map/random_evidence.h"

namespace soundmap::sound_map {
namespace {

std::vector<TileBlob> SomeBlobs(int scans = 60) {
  const auto map = SoundMap::Create(DefaultConfig()).value();
  for (const auto& scan : RandomScans(scans, 800, 21)) {
    if (!map->Apply(scan).ok()) ADD_FAILURE();
  }
  return map->TakeDirtyTiles();
}

TEST(TileBlob, RoundTripKeepsEveryField) {
  const auto map = SoundMap::Create(DefaultConfig()).value();
  for (const auto& scan : RandomScans(60, 800, 22)) ASSERT_TRUE(map->Apply(scan).ok());
  const auto snapshot = map->TakeSnapshot();
  const auto loaded = SoundMap::Create(DefaultConfig()).value();
  for (const TileBlob& blob : map->TakeDirtyTiles()) ASSERT_TRUE(loaded->Load(blob).ok());
  const auto copy = loaded->TakeSnapshot();
  ASSERT_EQ(copy->voxel_count(), snapshot->voxel_count());
  snapshot->ForEach([&](const geometry::VoxelKey& key, const Voxel& voxel) {
    EXPECT_EQ(copy->Find(key), voxel);
    EXPECT_EQ(copy->FindSupport(key), snapshot->FindSupport(key));
    return true;
  });
}

TEST(TileBlob, TheSameVoxelsGiveTheSameBytes) {
  for (const TileBlob& blob : SomeBlobs()) {
    const auto tile = ParseTile(blob, 0.05);
    ASSERT_TRUE(tile.ok());
    EXPECT_EQ(SerializeTile(**tile, 0.05), blob.bytes);
  }
}

TEST(TileBlob, AFullTileFits) {
  const auto map = SoundMap::Create(DefaultConfig()).value();
  frames::TimeNs stamp_ns = 0;
  for (int z = 0; z < 32; ++z) {
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 32; ++x) {
        ++stamp_ns;
        ASSERT_TRUE(map->Apply({stamp_ns,
                                {{{static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y),
                                   static_cast<std::uint16_t>(z)},
                                  0.9f}}})
                        .ok());
      }
    }
  }
  const auto blobs = map->TakeDirtyTiles();
  ASSERT_EQ(blobs.size(), 1u);
  const auto tile = ParseTile(blobs[0], 0.05);
  ASSERT_TRUE(tile.ok()) << tile.status();
  EXPECT_EQ((*tile)->voxel_count(), 32768);
}

TEST(TileBlob, ACutAnywhereIsDataLoss) {
  const TileBlob blob = SomeBlobs(3).front();
  for (std::size_t length = 0; length < blob.bytes.size(); ++length) {
    const auto tile = ParseTile({blob.key, blob.bytes.substr(0, length)}, 0.05);
    ASSERT_EQ(tile.status().code(), absl::StatusCode::kDataLoss) << length;
  }
}

TEST(TileBlob, AFlippedBitAnywhereIsRefused) {
  const TileBlob blob = SomeBlobs(3).front();
  for (std::size_t bit = 0; bit < 8 * blob.bytes.size(); ++bit) {
    TileBlob damaged = blob;
    damaged.bytes[bit / 8] = static_cast<char>(damaged.bytes[bit / 8] ^ (1 << (bit % 8)));
    const auto tile = ParseTile(damaged, 0.05);
    ASSERT_FALSE(tile.ok()) << bit;
    // A flip in the version reads as a newer one, all others as damage.
    const bool in_version = bit / 8 == 4 || bit / 8 == 5;
    if (!in_version) {
      ASSERT_EQ(tile.status().code(), absl::StatusCode::kDataLoss) << bit;
    }
  }
}

TEST(TileBlob, ForeignTilesAreNamed) {
  const TileBlob blob = SomeBlobs(3).front();
  TileBlob moved = blob;
  moved.key.x += 1;
  EXPECT_EQ(ParseTile(moved, 0.05).status().code(), absl::StatusCode::kInvalidArgument);
  const auto other_size = ParseTile(blob, 0.1).status();
  EXPECT_EQ(other_size.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(other_size.message().find("0.05"), absl::string_view::npos);
  TileBlob newer = blob;
  newer.bytes[4] = 2;
  EXPECT_NE(ParseTile(newer, 0.05).status().message().find("version 2"), absl::string_view::npos);
}

}  // namespace
}  // namespace soundmap::sound_map
