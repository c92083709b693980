#include "geometry/voxel_key.h"

#include <gtest/gtest.h>
#include <octomap/octomap.h>

#include <limits>
#include <random>
#include <unordered_set>

namespace soundmap::geometry {
namespace {

TEST(VoxelKey, IsOctoMapsKey) {
  const octomap::OcTree tree(0.05);
  std::mt19937_64 engine(4);
  std::uniform_real_distribution<double> metres(-50.0, 50.0);
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d point(metres(engine), metres(engine), metres(engine));
    const auto key = KeyFromPoint(point, 0.05);
    ASSERT_TRUE(key.has_value());
    const octomap::OcTreeKey expected = tree.coordToKey(point.x(), point.y(), point.z());
    EXPECT_EQ(key->x, expected[0]);
    EXPECT_EQ(key->y, expected[1]);
    EXPECT_EQ(key->z, expected[2]);
    EXPECT_LE((PointFromKey(*key, 0.05) - point).cwiseAbs().maxCoeff(), 0.025 + 1e-9);
    const octomap::point3d centre = tree.keyToCoord(expected);
    EXPECT_NEAR(PointFromKey(*key, 0.05).x(), centre.x(), 1e-4);
  }
}

TEST(VoxelKey, NoneOutsideTheTree) {
  EXPECT_TRUE(KeyFromPoint({1638.3, -1638.3, 0.0}, 0.05).has_value());
  EXPECT_FALSE(KeyFromPoint({1638.45, 0.0, 0.0}, 0.05).has_value());
  EXPECT_FALSE(KeyFromPoint({0.0, -1638.45, 0.0}, 0.05).has_value());
  EXPECT_FALSE(
      KeyFromPoint({0.0, 0.0, std::numeric_limits<double>::quiet_NaN()}, 0.05).has_value());
  EXPECT_FALSE(KeyFromPoint({std::numeric_limits<double>::infinity(), 0.0, 0.0}, 0.05).has_value());
  EXPECT_FALSE(KeyFromPoint({1e300, 0.0, 0.0}, 0.05).has_value());
}

TEST(VoxelKey, HashSpreadsNeighbours) {
  std::unordered_set<std::size_t> hashes;
  for (std::uint16_t x = 32700; x < 32720; ++x) {
    for (std::uint16_t y = 32700; y < 32720; ++y) {
      for (std::uint16_t z = 32700; z < 32720; ++z) {
        hashes.insert(std::hash<VoxelKey>()(VoxelKey{x, y, z}));
      }
    }
  }
  EXPECT_EQ(hashes.size(), 8000u);
}

}  // namespace
}  // namespace soundmap::geometry
