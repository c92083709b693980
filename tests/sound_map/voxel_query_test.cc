#include "sound_map/voxel_query.h"

#include <gtest/gtest.h>

#include <map>

#include "sound_map/sound_map.h"
#include "tests/sound_map/random_evidence.h"

namespace soundmap::sound_map {
namespace {

std::shared_ptr<const Snapshot> SomeSnapshot() {
  const auto map = SoundMap::Create(DefaultConfig()).value();
  for (const auto& scan : RandomScans(40, 1500, 31)) {
    if (!map->Apply(scan).ok()) ADD_FAILURE();
  }
  return map->TakeSnapshot();
}

TEST(FindVoxels, GivesThoseWhoseCentreIsInTheBoxAndThatPassTheFilters) {
  const auto snapshot = SomeSnapshot();
  VoxelQuery query;
  query.min_in_map_m = {-1.31, -0.72, 0.0};
  query.max_in_map_m = {2.04, 3.0, 0.2};
  query.min_updates = 2;
  query.min_probability = 0.6;
  std::map<geometry::VoxelKey, Voxel> expected;
  snapshot->ForEach([&](const geometry::VoxelKey& key, const Voxel& voxel) {
    const Eigen::Array3d centre = geometry::PointFromKey(key, 0.05).array();
    const bool inside = (centre >= query.min_in_map_m.array()).all() &&
                        (centre <= query.max_in_map_m.array()).all();
    if (inside && voxel.update_count > 2 && voxel.log_odds >= std::log(0.6 / 0.4)) {
      expected[key] = voxel;
    }
    return true;
  });
  ASSERT_GT(expected.size(), 20u);

  const auto page = FindVoxels(*snapshot, query).value();
  EXPECT_FALSE(page.more);
  std::map<geometry::VoxelKey, Voxel> found;
  for (std::size_t i = 0; i < page.keys.size(); ++i) found[page.keys[i]] = page.voxels[i];
  EXPECT_EQ(found, expected);

  // Page by page, the same in the same order.
  std::vector<geometry::VoxelKey> paged;
  query.limit = 7;
  for (bool more = true; more;) {
    const auto part = FindVoxels(*snapshot, query).value();
    EXPECT_LE(part.keys.size(), 7u);
    paged.insert(paged.end(), part.keys.begin(), part.keys.end());
    more = part.more;
    if (more) query.after = part.keys.back();
  }
  EXPECT_EQ(paged, page.keys);
}

TEST(FindVoxels, BoxesBeyondTheOctreeAreCut) {
  const auto snapshot = SomeSnapshot();
  VoxelQuery query;
  query.min_in_map_m = Eigen::Vector3d::Constant(-1e12);
  query.max_in_map_m = Eigen::Vector3d::Constant(1e12);
  EXPECT_EQ(FindVoxels(*snapshot, query)->keys.size(), snapshot->voxel_count());
  query.min_in_map_m.x() = 1e9;
  EXPECT_TRUE(FindVoxels(*snapshot, query)->keys.empty());
  query.min_in_map_m.x() = -std::numeric_limits<double>::infinity();
  query.max_in_map_m.x() = std::numeric_limits<double>::infinity();
  EXPECT_EQ(FindVoxels(*snapshot, query)->keys.size(), snapshot->voxel_count());
}

TEST(FindVoxels, RefusesWhatIsNoBox) {
  const auto snapshot = SomeSnapshot();
  VoxelQuery query;
  query.max_in_map_m = {1, 1, -1};
  EXPECT_FALSE(FindVoxels(*snapshot, query).ok());
  query.max_in_map_m = {1, 1, std::numeric_limits<double>::quiet_NaN()};
  EXPECT_FALSE(FindVoxels(*snapshot, query).ok());
  query.max_in_map_m = {1, 1, 1};
  query.limit = 0;
  EXPECT_FALSE(FindVoxels(*snapshot, query).ok());
  query.limit = 1;
  query.min_probability = 1.5;
  EXPECT_FALSE(FindVoxels(*snapshot, query).ok());
}

}  // namespace
}  // namespace soundmap::sound_map
