#include "sound_map/sound_sources.h"

#include <gtest/gtest.h>

#include <random>

#include "sound_map/sound_map.h"

namespace soundmap::sound_map {
namespace {

// A ceiling of 4 x 4 m at 2.7 m, seen whole in every scan. Around each source the voxels that a
// scan's peak, which lands beside the source by some centimetres, points at speak for it.
struct PlantedSource {
  Eigen::Vector2d place_m;
  double heard_share = 1.0;  // of the scans
};

constexpr double kVoxel_m = 0.05;
constexpr double kHeight_m = 2.7;

std::unique_ptr<SoundMap> MapWith(const std::vector<PlantedSource>& sources, int scans,
                                  const SoundMapConfig& config) {
  std::mt19937 random(11);
  std::normal_distribution<double> miss_m(0.0, 0.08);
  std::uniform_real_distribution<double> share(0.0, 1.0);
  auto map = SoundMap::Create(config).value();
  for (int k = 0; k < scans; ++k) {
    std::vector<Eigen::Vector2d> peaks;
    for (const PlantedSource& source : sources) {
      const Eigen::Vector2d peak = source.place_m + Eigen::Vector2d(miss_m(random), miss_m(random));
      if (share(random) < source.heard_share) peaks.push_back(peak);
    }
    EvidenceScan scan;
    scan.stamp_ns = 1'000'000'000LL * (k + 1);
    for (double x = 0.025; x < 4.0; x += kVoxel_m) {
      for (double y = 0.025; y < 4.0; y += kVoxel_m) {
        float likelihood = 0.4f;
        for (const Eigen::Vector2d& peak : peaks) {
          const double distance_m = (Eigen::Vector2d(x, y) - peak).norm();
          if (distance_m < 0.1) {
            likelihood = 0.9f;
          } else if (distance_m < 0.35) {
            likelihood = std::max(likelihood, 0.5f);
          }
        }
        scan.end_points.push_back(
            {*geometry::KeyFromPoint(Eigen::Vector3d(x, y, kHeight_m), kVoxel_m), likelihood});
      }
    }
    EXPECT_TRUE(map->Apply(scan).ok());
  }
  return map;
}

const SoundSource* Near(const std::vector<SoundSource>& sources, const Eigen::Vector2d& place_m) {
  for (const SoundSource& source : sources) {
    if ((source.position_in_map_m.head<2>() - place_m).norm() < 0.3) return &source;
  }
  return nullptr;
}

TEST(SoundSources, EachPlantedSourceIsFoundOnceWhereItIs) {
  const std::vector<PlantedSource> planted = {
      {{0.8, 0.9}}, {{3.1, 1.0}}, {{2.0, 3.2}, /*heard_share=*/0.4}};
  const SoundMapConfig config = DefaultConfig();
  const auto map = MapWith(planted, 150, config);
  const auto sources = FindSoundSources(*map->TakeSnapshot(), config.sources);
  ASSERT_EQ(sources.size(), planted.size());
  for (const PlantedSource& source : planted) {
    const SoundSource* found = Near(sources, source.place_m);
    ASSERT_NE(found, nullptr) << source.place_m.transpose();
    EXPECT_LT((found->position_in_map_m.head<2>() - source.place_m).norm(), 0.03);
    EXPECT_NEAR(found->position_in_map_m.z(), kHeight_m, 0.03);
    EXPECT_GT(found->probability, 0.9);
    EXPECT_GT(found->evidence_count, 100u);
    EXPECT_LE(found->first_heard_ns, 20'000'000'000);
    EXPECT_GE(found->last_heard_ns, 130'000'000'000);
  }
}

TEST(SoundSources, SilenceHasNone) {
  const SoundMapConfig config = DefaultConfig();
  EXPECT_TRUE(FindSoundSources(*MapWith({}, 30, config)->TakeSnapshot(), config.sources).empty());
  const auto empty = SoundMap::Create(config).value();
  EXPECT_TRUE(FindSoundSources(*empty->TakeSnapshot(), config.sources).empty());
}

TEST(SoundSources, KeepTheirIdsWhileMoreIsHeard) {
  const std::vector<PlantedSource> planted = {{{0.8, 0.9}}, {{3.1, 1.0}}};
  const SoundMapConfig config = DefaultConfig();
  const auto early =
      FindSoundSources(*MapWith(planted, 80, config)->TakeSnapshot(), config.sources);
  const auto late =
      FindSoundSources(*MapWith(planted, 160, config)->TakeSnapshot(), config.sources);
  for (const PlantedSource& source : planted) {
    ASSERT_NE(Near(early, source.place_m), nullptr);
    ASSERT_NE(Near(late, source.place_m), nullptr);
    EXPECT_EQ(Near(early, source.place_m)->id, Near(late, source.place_m)->id);
  }
}

// Section VI: with one cluster a plateau, k-means gives the mean of its voxels with L > 0.
TEST(SoundSources, KMeansGivesTheMeanOfThePositiveVoxels) {
  const SoundMapConfig config = PaperConfig();
  auto map = SoundMap::Create(config).value();
  EvidenceScan scan;
  scan.stamp_ns = 1;
  Eigen::Vector3d sums[2] = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  int counts[2] = {0, 0};
  for (int cluster = 0; cluster < 2; ++cluster) {
    for (int i = 0; i < 5; ++i) {
      for (int j = 0; j < 3 + cluster; ++j) {
        const geometry::VoxelKey key{static_cast<std::uint16_t>(32800 + 60 * cluster + i),
                                     static_cast<std::uint16_t>(32800 + j), 32820};
        scan.end_points.push_back({key, 0.999f});
        sums[cluster] += geometry::PointFromKey(key, kVoxel_m);
        ++counts[cluster];
      }
    }
  }
  scan.end_points.push_back({{32700, 32700, 32820}, 0.1f});
  ASSERT_TRUE(map->Apply(scan).ok());
  const auto sources = FindSoundSources(*map->TakeSnapshot(), config.sources);
  ASSERT_EQ(sources.size(), 2u);
  for (int cluster = 0; cluster < 2; ++cluster) {
    const Eigen::Vector3d mean = sums[cluster] / counts[cluster];
    const SoundSource* found = Near(sources, mean.head<2>());
    ASSERT_NE(found, nullptr);
    EXPECT_LT((found->position_in_map_m - mean).norm(), 1e-9);
    EXPECT_EQ(found->voxel_count, counts[cluster]);
  }
}

}  // namespace
}  // namespace soundmap::sound_map
