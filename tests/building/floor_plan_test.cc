#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <cmath>
#include <limits>
#include <random>

#include "building/building.h"

namespace soundmap::building {
namespace {

octomap::OcTree RandomTree(double voxel_size_m, unsigned seed) {
  octomap::OcTree octree(voxel_size_m);
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> key(32768 - 20, 32768 + 19);
  std::bernoulli_distribution occupied(0.3);
  for (int i = 0; i < 4000; ++i) {
    const octomap::OcTreeKey voxel(key(random), key(random), key(random));
    octree.setNodeValue(voxel, occupied(random) ? 3.5f : -2.0f);
  }
  // A solid and a hollow block, so that pruning merges leaves of several levels.
  for (int x = 0; x < 16; ++x) {
    for (int y = 0; y < 16; ++y) {
      for (int z = 0; z < 16; ++z) {
        octree.setNodeValue(octomap::OcTreeKey(32768 + x, 32768 + y, 32768 + z), -2.0f);
        octree.setNodeValue(octomap::OcTreeKey(32752 + x, 32752 + y, 32752 + z), 3.5f);
      }
    }
  }
  octree.prune();
  return octree;
}

TEST(SliceFloorPlan, EqualsALookUpOfEachVoxel) {
  const double size_m = 0.05;
  const octomap::OcTree octree = RandomTree(size_m, 1);
  // Layers -3 .. 4: the heights lie on boundaries, where the neighbouring layers must not count.
  const auto plan = SliceFloorPlan(octree, -3 * size_m, 5 * size_m);
  ASSERT_TRUE(plan.ok()) << plan.status();
  EXPECT_EQ(plan->cell_size_m(), size_m);
  EXPECT_NEAR(plan->origin_in_map_m().x(), -20 * size_m, 1e-9);
  EXPECT_NEAR(plan->origin_in_map_m().y(), -20 * size_m, 1e-9);
  ASSERT_EQ(plan->width(), 40);
  ASSERT_EQ(plan->height(), 40);
  int counts[3] = {0, 0, 0};
  for (int row = 0; row < 40; ++row) {
    for (int column = 0; column < 40; ++column) {
      Cell expected = Cell::kUnknown;
      for (int z = 32768 - 3; z <= 32768 + 4; ++z) {
        const auto* node =
            octree.search(octomap::OcTreeKey(32768 - 20 + column, 32768 - 20 + row, z));
        if (!node) continue;
        expected = std::max(expected, octree.isNodeOccupied(node) ? Cell::kOccupied : Cell::kFree);
      }
      EXPECT_EQ(plan->at(column, row), expected) << column << ", " << row;
      ++counts[static_cast<int>(expected)];
    }
  }
  EXPECT_GT(counts[0], 10);
  EXPECT_GT(counts[1], 10);
  EXPECT_GT(counts[2], 10);
}

TEST(SliceFloorPlan, ASingleHeightIsOneLayer) {
  octomap::OcTree octree(0.1);
  octree.setNodeValue(octomap::point3d(0.05f, 0.05f, 0.25f), 3.5f);
  octree.setNodeValue(octomap::point3d(0.15f, 0.05f, 0.35f), 3.5f);
  const auto plan = SliceFloorPlan(octree, 0.32, 0.32);
  ASSERT_TRUE(plan.ok()) << plan.status();
  EXPECT_EQ(plan->width(), 1);
  EXPECT_NEAR(plan->origin_in_map_m().x(), 0.1, 1e-9);
}

TEST(SliceFloorPlan, RefusesHeightsWithoutKnowledge) {
  octomap::OcTree octree(0.1);
  octree.setNodeValue(octomap::point3d(0.0f, 0.0f, 0.0f), 3.5f);
  EXPECT_EQ(SliceFloorPlan(octree, 1.0, 2.0).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_FALSE(SliceFloorPlan(octree, 1.0, 0.0).ok());
  EXPECT_FALSE(SliceFloorPlan(octree, std::nan(""), 0.0).ok());
  EXPECT_FALSE(SliceFloorPlan(octree, 0.0, std::numeric_limits<double>::infinity()).ok());
  EXPECT_FALSE(SliceFloorPlan(octomap::OcTree(0.1), 0.0, 1.0).ok());
}

TEST(SliceFloorPlan, RefusesAPlanThatIsTooLarge) {
  octomap::OcTree octree(0.05);
  octree.setNodeValue(octomap::OcTreeKey(0, 0, 32768), 3.5f);
  octree.setNodeValue(octomap::OcTreeKey(65535, 65535, 32768), 3.5f);
  EXPECT_EQ(SliceFloorPlan(octree, 0.0, 0.05).status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace soundmap::building
