#include "sound_map/sound_map.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <limits>
#include <map>
#include <thread>

#include "tests/sound_map/random_evidence.h"

namespace soundmap::sound_map {
namespace {

using geometry::VoxelKey;

// Section V word by word, in double and in a std::map.
struct Literal {
  struct Fields {
    double log_odds = 0.0;
    std::uint32_t update_count = 0;
    std::optional<std::int64_t> last_update_ns;
    std::uint32_t heard = 0;
    std::int64_t first_heard_ns = std::numeric_limits<std::int64_t>::max();
    std::int64_t last_heard_ns = std::numeric_limits<std::int64_t>::min();
  };

  void Apply(const EvidenceScan& scan) {
    for (const EndPoint& end_point : scan.end_points) {
      Fields& voxel = voxels[end_point.key];
      const double p = end_point.likelihood;
      const double next = voxel.log_odds + std::log(p / (1.0 - p));
      if (freeze) {
        if (voxel.log_odds >= min && voxel.log_odds <= max) voxel.log_odds = next;
      } else {
        voxel.log_odds = std::min(std::max(next, min), max);
      }
      voxel.update_count += 1;
      if (!voxel.last_update_ns || *voxel.last_update_ns < scan.stamp_ns) {
        voxel.last_update_ns = scan.stamp_ns;
      }
      if (p > 0.5) {
        voxel.heard += 1;
        voxel.first_heard_ns = std::min(voxel.first_heard_ns, scan.stamp_ns);
        voxel.last_heard_ns = std::max(voxel.last_heard_ns, scan.stamp_ns);
      }
    }
  }

  bool freeze = true;
  double min = -40.0;
  double max = 40.0;
  std::map<VoxelKey, Fields> voxels;
};

void ExpectSame(const Snapshot& snapshot, const Literal& literal) {
  ASSERT_EQ(snapshot.voxel_count(), literal.voxels.size());
  for (const auto& [key, expected] : literal.voxels) {
    const auto voxel = snapshot.Find(key);
    ASSERT_TRUE(voxel.has_value());
    ASSERT_NEAR(voxel->log_odds, expected.log_odds, 1e-4);
    ASSERT_EQ(voxel->update_count, expected.update_count);
    ASSERT_EQ(voxel->last_update_ns, *expected.last_update_ns);
    const auto support = snapshot.FindSupport(key);
    ASSERT_EQ(support.has_value(), expected.heard > 0);
    if (!support) continue;
    ASSERT_EQ(support->count, expected.heard);
    ASSERT_EQ(support->first_heard_ns, expected.first_heard_ns);
    ASSERT_EQ(support->last_heard_ns, expected.last_heard_ns);
  }
}

std::unique_ptr<SoundMap> MakeMap(const SoundMapConfig& config) {
  return SoundMap::Create(config).value();
}

TEST(SoundMap, PaperFieldsEqualALiteralTranscription) {
  const auto map = MakeMap(PaperConfig());
  Literal literal;
  std::vector<std::shared_ptr<const Snapshot>> views;  // make the writer copy now and then
  const auto scans = RandomScans(300, 2000, 11);
  for (std::size_t i = 0; i < scans.size(); ++i) {
    ASSERT_TRUE(map->Apply(scans[i]).ok());
    literal.Apply(scans[i]);
    if (i % 37 == 0) views.push_back(map->TakeSnapshot());
    if (i % 100 == 99) ExpectSame(*map->TakeSnapshot(), literal);
  }
  int frozen = 0;
  for (const auto& [key, voxel] : literal.voxels) frozen += std::abs(voxel.log_odds) > 40.0;
  EXPECT_GT(frozen, 1000);
}

TEST(SoundMap, DefaultFieldsEqualALiteralTranscription) {
  SoundMapConfig config = DefaultConfig();
  const auto map = MakeMap(config);
  Literal literal{false, config.min_log_odds, config.max_log_odds, {}};
  for (const auto& scan : RandomScans(200, 2000, 12, {0.3f, 0.4f, 0.5f, 0.9f})) {
    ASSERT_TRUE(map->Apply(scan).ok());
    literal.Apply(scan);
  }
  ExpectSame(*map->TakeSnapshot(), literal);
}

EvidenceScan OneVoxel(float likelihood, frames::TimeNs stamp_ns, int times = 1) {
  return {stamp_ns, std::vector<EndPoint>(times, {VoxelKey{32768, 32768, 32768}, likelihood})};
}

// +6.9 a hit: after six 41.4, outside, where it stays; M and U go on.
TEST(SoundMap, PaperFreezesBeyondTheLimitAndCountsOn) {
  const auto map = MakeMap(PaperConfig());
  const VoxelKey key{32768, 32768, 32768};
  for (int i = 1; i <= 8; ++i) ASSERT_TRUE(map->Apply(OneVoxel(0.999f, i)).ok());
  EXPECT_NEAR(map->TakeSnapshot()->Find(key)->log_odds, 6 * std::log(0.999 / 0.001), 1e-3);
  ASSERT_TRUE(map->Apply(OneVoxel(0.001f, 9)).ok());
  const Voxel voxel = *map->TakeSnapshot()->Find(key);
  EXPECT_NEAR(voxel.log_odds, 6 * std::log(0.999 / 0.001), 1e-3);
  EXPECT_EQ(voxel.update_count, 9u);
  EXPECT_EQ(voxel.last_update_ns, 9);
}

TEST(SoundMap, DefaultUnlearnsASourceThatStopped) {
  const auto map = MakeMap(DefaultConfig());
  const VoxelKey key{32768, 32768, 32768};
  ASSERT_TRUE(map->Apply(OneVoxel(0.9f, 1, 1000)).ok());
  EXPECT_EQ(map->TakeSnapshot()->Find(key)->log_odds,
            static_cast<float>(DefaultConfig().max_log_odds));
  ASSERT_TRUE(map->Apply(OneVoxel(0.4f, 2, 1000)).ok());
  EXPECT_EQ(map->TakeSnapshot()->Find(key)->log_odds,
            static_cast<float>(DefaultConfig().min_log_odds));
}

TEST(SoundMap, ALateScanDoesNotMoveTimeBackwards) {
  const auto map = MakeMap(PaperConfig());
  const VoxelKey key{32768, 32768, 32768};
  for (const frames::TimeNs stamp_ns : {-5, 100, 40}) {
    ASSERT_TRUE(map->Apply(OneVoxel(0.9f, stamp_ns)).ok());
  }
  const auto snapshot = map->TakeSnapshot();
  EXPECT_EQ(snapshot->Find(key)->last_update_ns, 100);
  EXPECT_EQ(snapshot->FindSupport(key)->first_heard_ns, -5);
  EXPECT_EQ(snapshot->FindSupport(key)->last_heard_ns, 100);
  EXPECT_EQ(snapshot->as_of_ns(), 100);
  EXPECT_EQ(snapshot->revision(), 3u);
}

TEST(SoundMap, ALikelihoodOutsideTheOpenIntervalIsRefusedWhole) {
  for (const float likelihood : {0.0f, 1.0f, -0.1f, 2.0f, std::numeric_limits<float>::quiet_NaN(),
                                 std::numeric_limits<float>::infinity()}) {
    const auto map = MakeMap(PaperConfig());
    EvidenceScan scan = OneVoxel(0.9f, 1, 3);
    scan.end_points.back().likelihood = likelihood;
    EXPECT_EQ(map->Apply(scan).code(), absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(map->TakeSnapshot()->voxel_count(), 0u);
    EXPECT_EQ(map->TakeSnapshot()->revision(), 0u);
  }
}

TEST(SoundMap, TheCornersOfTheOctreeAreVoxelsLikeAnyOther) {
  const auto map = MakeMap(PaperConfig());
  EvidenceScan scan{1, {}};
  for (const std::uint16_t x : {0, 65535}) {
    for (const std::uint16_t y : {0, 65535}) {
      for (const std::uint16_t z : {0, 65535}) scan.end_points.push_back({{x, y, z}, 0.9f});
    }
  }
  ASSERT_TRUE(map->Apply(scan).ok());
  const auto snapshot = map->TakeSnapshot();
  EXPECT_EQ(snapshot->voxel_count(), 8u);
  std::vector<VoxelKey> seen;
  snapshot->ForEach([&](const VoxelKey& key, const Voxel& voxel) {
    EXPECT_EQ(voxel.update_count, 1u);
    seen.push_back(key);
    return true;
  });
  std::vector<VoxelKey> expected;
  for (const auto& end_point : scan.end_points) expected.push_back(end_point.key);
  EXPECT_EQ(seen, expected);
}

// More times in one tile than its stamps hold at once, each kept by some voxel for a while.
TEST(SoundMap, TimesSurviveRenumbering) {
  const auto map = MakeMap(PaperConfig());
  Literal literal;
  std::mt19937_64 random(5);
  std::shared_ptr<const Snapshot> held;
  for (int i = 0; i < 40'000; ++i) {
    const VoxelKey key{static_cast<std::uint16_t>(32768 + random() % 32),
                       static_cast<std::uint16_t>(32768 + random() % 32), 32770};
    const EvidenceScan scan{1'000'000 + 1000 * i, {{key, 0.5f}}};
    ASSERT_TRUE(map->Apply(scan).ok());
    literal.Apply(scan);
    if (i % 1000 == 0) held = map->TakeSnapshot();
  }
  ExpectSame(*map->TakeSnapshot(), literal);
  EXPECT_LT(map->MemoryBytes(), 60'000u);
}

TEST(SoundMap, ASnapshotStaysWhileTheWriterGoesOn) {
  const auto map = MakeMap(PaperConfig());
  const auto scans = RandomScans(120, 1000, 13);
  Literal literal;
  for (int i = 0; i < 60; ++i) {
    ASSERT_TRUE(map->Apply(scans[i]).ok());
    literal.Apply(scans[i]);
  }
  const auto before = map->TakeSnapshot();
  EXPECT_EQ(map->TakeSnapshot(), before);
  for (int i = 60; i < 120; ++i) ASSERT_TRUE(map->Apply(scans[i]).ok());
  ExpectSame(*before, literal);
  EXPECT_EQ(before->revision(), 60u);
  EXPECT_NE(map->TakeSnapshot(), before);
}

// Readers count while the writer writes: in every view the update counts sum up to the end points
// of its revision.
TEST(SoundMap, ReadersSeeWholeScans) {
  const auto map = MakeMap(PaperConfig());
  const auto scans = RandomScans(400, 500, 14);
  std::atomic<bool> done{false};
  std::atomic<int> views{0};
  std::vector<std::thread> readers;
  for (int reader = 0; reader < 2; ++reader) {
    readers.emplace_back([&] {
      std::uint64_t last_revision = 0;
      while (!done || views < 4) {
        const auto snapshot = map->TakeSnapshot();
        std::uint64_t updates = 0;
        snapshot->ForEach([&](const VoxelKey&, const Voxel& voxel) {
          updates += voxel.update_count;
          return true;
        });
        ASSERT_EQ(updates, 500 * snapshot->revision());
        ASSERT_GE(snapshot->revision(), last_revision);
        last_revision = snapshot->revision();
        ++views;
      }
    });
  }
  for (const auto& scan : scans) ASSERT_TRUE(map->Apply(scan).ok());
  done = true;
  for (std::thread& reader : readers) reader.join();
}

std::map<TileKey, std::string> ByKey(std::vector<TileBlob> blobs) {
  std::map<TileKey, std::string> by_key;
  for (TileBlob& blob : blobs) by_key[blob.key] = std::move(blob.bytes);
  return by_key;
}

TEST(SoundMap, OnlyChangedTilesAreDirty) {
  const auto map = MakeMap(PaperConfig());
  EXPECT_TRUE(map->TakeDirtyTiles().empty());
  const EndPoint here{{32768, 32768, 32768}, 0.9f};
  const EndPoint there{{32768 + 32, 32768, 32768}, 0.9f};
  ASSERT_TRUE(map->Apply({1, {here, there}}).ok());
  EXPECT_EQ(map->TakeDirtyTiles().size(), 2u);
  EXPECT_TRUE(map->TakeDirtyTiles().empty());
  ASSERT_TRUE(map->Apply({2, {there}}).ok());
  const auto blobs = map->TakeDirtyTiles();
  ASSERT_EQ(blobs.size(), 1u);
  EXPECT_EQ(blobs[0].key, TileOf(there.key));
  EXPECT_TRUE(map->TakeDirtyTiles().empty());
  map->MarkDirty(std::vector<TileKey>{blobs[0].key, TileKey{1, 2, 3}});
  EXPECT_EQ(map->TakeDirtyTiles(), blobs);
  EXPECT_EQ(map->TakeSnapshot()->TileRevision(TileOf(here.key)), 1u);
  EXPECT_EQ(map->TakeSnapshot()->TileRevision(TileOf(there.key)), 2u);
}

TEST(SoundMap, AScanOfAnotherMapIsCountedAndChangesNothing) {
  const auto map = MakeMap(PaperConfig());
  map->Skip();
  EXPECT_EQ(map->revision(), 1u);
  EXPECT_EQ(map->as_of_ns(), std::nullopt);
  const EndPoint here{{32768, 32768, 32768}, 0.9f};
  ASSERT_TRUE(map->Apply({7, {here}}).ok());
  map->TakeDirtyTiles();
  const auto before = map->TakeSnapshot();
  map->Skip();
  const auto after = map->TakeSnapshot();
  EXPECT_EQ(before->revision(), 2u);
  EXPECT_EQ(after->revision(), 3u);
  EXPECT_EQ(after->as_of_ns(), 7);
  EXPECT_EQ(after->TileRevision(TileOf(here.key)), 2u);
  EXPECT_EQ(after->Find(here.key)->update_count, 1u);
  EXPECT_TRUE(map->TakeDirtyTiles().empty());
}

// Checkpoint after 100 scans, a crash, the tiles back, the journal again from scan 100: the same
// bytes as without the crash.
TEST(SoundMap, TilesAndJournalGiveTheSameMap) {
  for (const SoundMapConfig& config : {PaperConfig(), DefaultConfig()}) {
    const auto scans = RandomScans(200, 1500, 15);
    const auto undisturbed = MakeMap(config);
    std::map<TileKey, std::string> stored;
    for (int i = 0; i < 100; ++i) {
      ASSERT_TRUE(undisturbed->Apply(scans[i]).ok());
      if (i % 30 != 0) continue;
      for (auto& [key, bytes] : ByKey(undisturbed->TakeDirtyTiles())) stored[key] = bytes;
    }
    for (auto& [key, bytes] : ByKey(undisturbed->TakeDirtyTiles())) stored[key] = bytes;

    const auto restarted = MakeMap(config);
    for (const auto& [key, bytes] : stored) ASSERT_TRUE(restarted->Load({key, bytes}).ok());
    EXPECT_EQ(restarted->TakeSnapshot()->revision(), undisturbed->TakeSnapshot()->revision());
    EXPECT_EQ(restarted->TakeSnapshot()->as_of_ns(), undisturbed->TakeSnapshot()->as_of_ns());
    EXPECT_TRUE(restarted->TakeDirtyTiles().empty());
    restarted->Restore(100, undisturbed->TakeSnapshot()->as_of_ns());
    for (int i = 100; i < 200; ++i) {
      ASSERT_TRUE(undisturbed->Apply(scans[i]).ok());
      ASSERT_TRUE(restarted->Apply(scans[i]).ok());
    }
    EXPECT_EQ(ByKey(restarted->TakeDirtyTiles()), ByKey(undisturbed->TakeDirtyTiles()));
    EXPECT_EQ(restarted->TakeSnapshot()->revision(), 200u);
  }
}

TEST(SoundMap, AConfigurationThatCannotBeIsRefusedByName) {
  const auto message = [](auto change) {
    SoundMapConfig config;
    change(config);
    return std::string(SoundMap::Create(config).status().message());
  };
  EXPECT_NE(message([](auto& c) { c.voxel_size_m = 0.0; }).find("voxel_size_m"), std::string::npos);
  EXPECT_NE(message([](auto& c) { c.min_log_odds = 1.0; }).find("min_log_odds"), std::string::npos);
  EXPECT_NE(message([](auto& c) { c.max_log_odds = NAN; }).find("max_log_odds"), std::string::npos);
  EXPECT_NE(message([](auto& c) { c.sources.max_seeds = 0; }).find("max_seeds"), std::string::npos);
  EXPECT_TRUE(PaperConfig().Validate().ok());
  EXPECT_TRUE(DefaultConfig().Validate().ok());
}

}  // namespace
}  // namespace soundmap::sound_map
