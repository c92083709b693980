#include "building/free_space.h"

#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <limits>
#include <random>
#include <vector>

namespace soundmap::building {
namespace {

constexpr double kVoxel_m = 0.05;

// Random boxes of occupied voxels in free air of 3 m; what is outside was never seen.
TEST(FreeSpace, IsFreeVoxelsFarFromOccupiedOnesByBruteForce) {
  auto octree = std::make_shared<octomap::OcTree>(kVoxel_m);
  std::mt19937 random(3);
  std::uniform_int_distribution<int> corner(-25, 20);
  std::vector<Eigen::Vector3i> boxes;
  for (int i = 0; i < 6; ++i) boxes.emplace_back(corner(random), corner(random), corner(random));
  std::vector<Eigen::Vector3d> occupied;
  for (int x = -30; x < 30; ++x) {
    for (int y = -30; y < 30; ++y) {
      for (int z = -30; z < 30; ++z) {
        const Eigen::Array3i key(x, y, z);
        bool in_box = false;
        for (const Eigen::Vector3i& box : boxes) {
          in_box |= (key >= box.array()).all() && (key < box.array() + 4).all();
        }
        octree->updateNode(octomap::OcTreeKey(32768 + x, 32768 + y, 32768 + z), in_box);
        if (in_box) occupied.push_back(kVoxel_m * (key.cast<double>() + 0.5).matrix());
      }
    }
  }
  octree->prune();
  const FreeSpace space(octree);

  std::uniform_real_distribution<double> place_m(-1.6, 1.6);
  int contained = 0;
  int near = 0;
  for (int i = 0; i < 4000; ++i) {
    const Eigen::Vector3d point(place_m(random), place_m(random), place_m(random));
    double nearest_m = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3d& centre : occupied) {
      const Eigen::Array3d beyond = ((point - centre).array().abs() - kVoxel_m / 2.0).max(0.0);
      nearest_m = std::min(nearest_m, beyond.matrix().norm());
    }
    const bool seen = (point.array().abs() < 1.5).all();
    // A cell of 0.1 m counts as a whole, at either end.
    if (space.Contains(point)) {
      ++contained;
      EXPECT_TRUE(seen) << point.transpose();
      EXPECT_GT(nearest_m, FreeSpace::kMargin_m - 0.18) << point.transpose();
    } else if (seen) {
      ++near;
      EXPECT_LT(nearest_m, FreeSpace::kMargin_m + 0.18) << point.transpose();
    }
  }
  EXPECT_GT(contained, 500);
  EXPECT_GT(near, 100);
  EXPECT_FALSE(space.Contains(Eigen::Vector3d::Constant(std::nan(""))));
  EXPECT_FALSE(space.Contains(Eigen::Vector3d::Constant(1e9)));
}

}  // namespace
}  // namespace soundmap::building
