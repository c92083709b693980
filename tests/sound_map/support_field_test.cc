#include "sound_map/support_field.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>

#include "sound_map/sound_map.h"
#include "sound_map/sound_sources.h"
#include "tests/sound_map/random_evidence.h"

namespace soundmap::sound_map {
namespace {

constexpr double kVoxel_m = 0.05;

std::unique_ptr<SoundMap> EmptyMap() { return SoundMap::Create(DefaultConfig()).value(); }

// The definition, voxel by voxel in double precision.
SupportField::Counts CountsByDefinition(const Snapshot& snapshot, const geometry::VoxelKey& key,
                                        double sigma_voxels) {
  const int radius = static_cast<int>(std::ceil(2.5 * sigma_voxels));
  SupportField::Counts counts;
  for (int dz = -radius; dz <= radius; ++dz) {
    for (int dy = -radius; dy <= radius; ++dy) {
      for (int dx = -radius; dx <= radius; ++dx) {
        const geometry::VoxelKey near{static_cast<std::uint16_t>(key.x + dx),
                                      static_cast<std::uint16_t>(key.y + dy),
                                      static_cast<std::uint16_t>(key.z + dz)};
        const double weight =
            std::exp(-0.5 * (dx * dx + dy * dy + dz * dz) / (sigma_voxels * sigma_voxels));
        if (const auto voxel = snapshot.Find(near)) counts.all += weight * voxel->update_count;
        if (const auto support = snapshot.FindSupport(near)) {
          counts.supporting += weight * support->count;
        }
      }
    }
  }
  return counts;
}

TEST(SupportField, CountsAsDefinedAcrossTilesAndForAnyWidth) {
  for (const double sigma_voxels : {0.5, 2.0, 3.3, 5.0}) {
    const auto map = EmptyMap();
    for (const EvidenceScan& scan : RandomScans(30, 3000, 5)) ASSERT_TRUE(map->Apply(scan).ok());
    const auto snapshot = map->TakeSnapshot();
    SupportField field(sigma_voxels * kVoxel_m, /*min_updates=*/0, /*max_voxels=*/1'000'000);
    int visited = 0;
    std::set<geometry::VoxelKey> seen;
    for (const TileKey& tile : field.Follow(*snapshot)) {
      field.ForEachCount(
          *snapshot, tile, 0.02,
          [&](const ObservedVoxel& voxel, const SupportField::Counts& counts) {
            EXPECT_TRUE(seen.insert(voxel.key).second);
            EXPECT_GT(voxel.support.count, 1u);
            if (++visited % 29 != 0) return;
            const auto expected = CountsByDefinition(*snapshot, voxel.key, sigma_voxels);
            EXPECT_NEAR(counts.all, expected.all, 1e-5 * expected.all);
            EXPECT_NEAR(counts.supporting, expected.supporting, 1e-5 * expected.supporting);
          });
    }
    EXPECT_GT(visited, 1000);
  }
}

TEST(SupportField, OfTooManyVoxelsThoseWithTheMostSupportTakePart) {
  const auto map = EmptyMap();
  for (const EvidenceScan& scan : RandomScans(60, 3000, 6)) ASSERT_TRUE(map->Apply(scan).ok());
  const auto snapshot = map->TakeSnapshot();
  const auto around_all = [&](SupportField& field) {
    field.Follow(*snapshot);
    return field.Around(Eigen::Vector3d(0.0, 0.0, 0.1), 6.0);
  };
  SupportField all(0.1, 0, 1'000'000);
  SupportField some(0.1, 0, 1000);
  const auto voxels = around_all(all);
  const auto kept = around_all(some);
  ASSERT_GT(voxels.size(), 5000u);
  EXPECT_LE(kept.size(), 1000u);
  EXPECT_GT(kept.size(), 100u);
  std::uint32_t least = UINT32_MAX;
  for (const auto* voxel : kept) least = std::min(least, voxel->support.count);
  EXPECT_EQ(std::count_if(voxels.begin(), voxels.end(),
                          [&](const auto* voxel) { return voxel->support.count >= least; }),
            static_cast<std::ptrdiff_t>(kept.size()));
}

// A robot that drives past one tile after the other hears each only now and then, and places across
// the border of the tile where something sounds.
std::vector<EvidenceScan> ScansHereAndThere(int count) {
  std::mt19937_64 random(7);
  std::vector<EvidenceScan> scans = RandomScans(count, 1500, 8, {0.4f, 0.4f, 0.4f, 0.4f, 0.9f});
  for (int k = 0; k < count; ++k) {
    const std::uint16_t corner = 32768 - 70 + 20 * (k % 6);
    std::erase_if(scans[k].end_points, [&](const EndPoint& end_point) {
      return end_point.key.x < corner || end_point.key.x > corner + 28;
    });
    // Something that sounds where these scans look, on the border of two tiles.
    for (int i = 0; i < 40; ++i) {
      scans[k].end_points.push_back({{static_cast<std::uint16_t>(corner + 10 + random() % 3),
                                      static_cast<std::uint16_t>(32767 + random() % 3), 32770},
                                     0.9f});
    }
  }
  return scans;
}

TEST(SourceFinder, FindsTheSameAsASearchOfTheWholeMap) {
  for (const int max_voxels : {1'000'000, 700}) {
    const auto map = EmptyMap();
    SoundSourceConfig config = DefaultConfig().sources;
    config.max_voxels = max_voxels;
    SourceFinder finder(config);
    std::size_t most = 0;
    const std::vector<EvidenceScan> scans = ScansHereAndThere(120);
    for (std::size_t k = 0; k < scans.size(); ++k) {
      ASSERT_TRUE(map->Apply(scans[k]).ok());
      const std::vector<SoundSource> found = finder.Find(map->Present());
      ASSERT_EQ(found, FindSoundSources(*map->TakeSnapshot(), config)) << "after scan " << k;
      most = std::max(most, found.size());
    }
    EXPECT_GE(most, 3u);
  }
}

TEST(SourceFinder, ForgetsTilesThatAreGone) {
  const auto map = EmptyMap();
  for (const EvidenceScan& scan : ScansHereAndThere(60)) ASSERT_TRUE(map->Apply(scan).ok());
  SourceFinder finder(DefaultConfig().sources);
  EXPECT_FALSE(finder.Find(map->Present()).empty());
  EXPECT_TRUE(finder.Find(EmptyMap()->Present()).empty());
}

}  // namespace
}  // namespace soundmap::sound_map
