#include "mapping/occupancy_grid.h"

#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <set>

#include "building/building.h"

namespace soundmap::mapping {
namespace {

using building::Cell;
using geometry::VoxelKey;

constexpr double kVoxel_m = 0.05;

Cell At(const octomap::OcTree& octree, const Eigen::Vector3d& point) {
  const auto* node = octree.search(point.x(), point.y(), point.z());
  if (!node) return Cell::kUnknown;
  return octree.isNodeOccupied(node) ? Cell::kOccupied : Cell::kFree;
}

TEST(OccupancyGrid, OneRayAlongAnAxis) {
  OccupancyGrid grid(kVoxel_m, {});
  ASSERT_TRUE(
      grid.InsertScan(std::vector<Ray>{{{0.02f, 0.02f, 0.02f}, {1.02f, 0.02f, 0.02f}}}).ok());
  const auto octree = grid.ToOctree();
  for (int x = -2; x < 25; ++x) {
    const Cell expected = x < 0 || x > 20 ? Cell::kUnknown : x < 20 ? Cell::kFree : Cell::kOccupied;
    EXPECT_EQ(At(*octree, {(x + 0.5) * kVoxel_m, 0.02, 0.02}), expected) << x;
  }
  EXPECT_EQ(At(*octree, {0.5, 0.07, 0.02}), Cell::kUnknown);
}

TEST(OccupancyGrid, TheMarginIsNotFree) {
  OccupancyGrid grid(kVoxel_m, {});
  ASSERT_TRUE(
      grid.InsertScan(std::vector<Ray>{{{0.02f, 0.02f, 0.02f}, {1.02f, 0.02f, 0.02f}, 0.5f}}).ok());
  const auto octree = grid.ToOctree();
  EXPECT_EQ(At(*octree, {0.49, 0.02, 0.02}), Cell::kFree);
  EXPECT_EQ(At(*octree, {0.57, 0.02, 0.02}), Cell::kUnknown);
  EXPECT_EQ(At(*octree, {1.02, 0.02, 0.02}), Cell::kOccupied);
}

// Each ray a scan of its own, so that every voxel's counts show.
TEST(OccupancyGrid, RandomRaysPassThroughWhatFineStepsPassThrough) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> coordinate(-1.0f, 1.0f);
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector3d origin =
        Eigen::Vector3f(coordinate(random), coordinate(random), coordinate(random)).cast<double>();
    const Eigen::Vector3d end =
        Eigen::Vector3f(coordinate(random), coordinate(random), coordinate(random)).cast<double>();
    OccupancyGrid grid(kVoxel_m, {});
    ASSERT_TRUE(grid.InsertScan(std::vector<Ray>{{origin.cast<float>(), end.cast<float>()}}).ok());
    const auto octree = grid.ToOctree();

    // Steps of 20 um; a voxel whose corner the ray cuts by less may be missed by the steps.
    std::map<VoxelKey, double> expected;  // length inside
    const double length = (end - origin).norm();
    const int steps = static_cast<int>(length / 2e-5);
    for (int s = 0; s <= steps; ++s) {
      const Eigen::Vector3d point = origin + (end - origin) * s / steps;
      expected[*geometry::KeyFromPoint(point, kVoxel_m)] += length / steps;
    }
    octree->expand();
    std::set<VoxelKey> known;
    for (auto leaf = octree->begin_leafs(); leaf != octree->end_leafs(); ++leaf) {
      const octomap::OcTreeKey key = leaf.getKey();
      known.insert({key[0], key[1], key[2]});
    }
    int extra = 0;
    for (const VoxelKey& key : known) extra += expected.count(key) == 0;
    EXPECT_LE(extra, 1) << i;
    for (const auto& [key, inside_m] : expected) {
      EXPECT_TRUE(known.count(key) == 1 || inside_m < 1e-4) << i << " " << inside_m;
    }
    EXPECT_EQ(At(*octree, end), Cell::kOccupied);
    EXPECT_EQ(At(*octree, origin),
              *geometry::KeyFromPoint(origin, kVoxel_m) == *geometry::KeyFromPoint(end, kVoxel_m)
                  ? Cell::kOccupied
                  : Cell::kFree);
  }
}

TEST(OccupancyGrid, WithinAScanAPointOutweighsTheRaysThroughIt) {
  OccupancyGrid grid(kVoxel_m, {});
  std::vector<Ray> rays(50, Ray{{0.02f, 0.02f, 0.02f}, {2.02f, 0.02f, 0.02f}});
  rays.push_back({{0.02f, 0.02f, 0.02f}, {1.02f, 0.02f, 0.02f}});
  ASSERT_TRUE(grid.InsertScan(rays).ok());
  EXPECT_EQ(At(*grid.ToOctree(), {1.02, 0.02, 0.02}), Cell::kOccupied);
}

TEST(OccupancyGrid, WhatMovedAwayErodes) {
  const std::vector<Ray> person = {{{0.02f, 0.02f, 0.02f}, {1.02f, 0.02f, 0.02f}},
                                   {{0.02f, 0.07f, 0.02f}, {1.02f, 0.07f, 0.02f}}};
  const std::vector<Ray> wall = {{{0.02f, 0.02f, 0.02f}, {2.02f, 0.02f, 0.02f}},
                                 {{0.02f, 0.07f, 0.02f}, {2.02f, 0.07f, 0.02f}}};
  OccupancyGrid grid(kVoxel_m, {});
  for (int i = 0; i < 1000; ++i) ASSERT_TRUE(grid.InsertScan(person).ok());
  // Clamped at 3.5, a miss takes 0.4: after eight misses 0.3 is left, after nine nothing.
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(grid.InsertScan(wall).ok());
  EXPECT_EQ(At(*grid.ToOctree(), {1.02, 0.02, 0.02}), Cell::kOccupied);
  ASSERT_TRUE(grid.InsertScan(wall).ok());
  EXPECT_EQ(At(*grid.ToOctree(), {1.02, 0.02, 0.02}), Cell::kFree);
}

// Something that moved leaves a voxel here and there that one scan hit and another saw through.
TEST(OccupancyGrid, ASpeckleIsFree) {
  const Ray hit{{0.02f, 0.02f, 0.02f}, {1.02f, 0.02f, 0.02f}};
  const Ray beside{{0.02f, 0.07f, 0.02f}, {1.02f, 0.07f, 0.02f}};
  const Ray through{{0.02f, 0.02f, 0.02f}, {2.02f, 0.02f, 0.02f}};
  for (const bool has_neighbour : {false, true}) {
    OccupancyGrid grid(kVoxel_m, {});
    ASSERT_TRUE(grid.InsertScan(std::vector{hit}).ok());
    EXPECT_EQ(At(*grid.ToOctree(), {1.02, 0.02, 0.02}), Cell::kOccupied);
    if (has_neighbour) {
      ASSERT_TRUE(grid.InsertScan(std::vector{beside}).ok());
    }
    ASSERT_TRUE(grid.InsertScan(std::vector{through}).ok());
    EXPECT_EQ(At(*grid.ToOctree(), {1.02, 0.02, 0.02}),
              has_neighbour ? Cell::kOccupied : Cell::kFree);
  }
}

// Leaves of any size come in with the voxels whose centres they hold.
TEST(OccupancyGrid, TakesInWhatAnotherMapKnows) {
  for (const double size_m : {0.02, 0.05, 0.08, 0.1}) {
    octomap::OcTree known(size_m);
    for (double x = 0.5 * size_m; x < 0.8; x += size_m) {
      for (double y = 0.5 * size_m; y < 0.8; y += size_m) {
        known.updateNode(octomap::point3d(static_cast<float>(x), static_cast<float>(y),
                                          static_cast<float>(0.5 * size_m)),
                         x > 0.4);
      }
    }
    known.prune();
    OccupancyGrid grid(kVoxel_m, {});
    ASSERT_TRUE(grid.InsertKnown(known).ok());
    const auto octree = grid.ToOctree();
    for (const double y : {0.025, 0.375, 0.725}) {
      EXPECT_EQ(At(*octree, {0.025, y, 0.025}), Cell::kFree) << size_m;
      EXPECT_EQ(At(*octree, {0.325, y, 0.025}), Cell::kFree) << size_m;
      EXPECT_EQ(At(*octree, {0.475, y, 0.025}), Cell::kOccupied) << size_m;
      EXPECT_EQ(At(*octree, {0.725, y, 0.025}), Cell::kOccupied) << size_m;
    }
    EXPECT_EQ(At(*octree, {0.925, 0.025, 0.025}), Cell::kUnknown) << size_m;
  }
}

TEST(OccupancyGrid, AFullMapIsAnError) {
  OccupancyGrid grid(kVoxel_m, {.max_blocks = 10});
  EXPECT_TRUE(grid.InsertScan(std::vector<Ray>{{{0, 0, 0}, {2, 0, 0}}}).ok());
  EXPECT_EQ(grid.InsertScan(std::vector<Ray>{{{0, 0, 0}, {0, 200, 0}}}).code(),
            absl::StatusCode::kResourceExhausted);
}

TEST(OccupancyGrid, LeavesOutRaysThatAreNotInTheMap) {
  OccupancyGrid grid(kVoxel_m, {});
  const float nan = std::nanf("");
  const float infinity = std::numeric_limits<float>::infinity();
  EXPECT_TRUE(grid.InsertScan(std::vector<Ray>{{{0, 0, 0}, {nan, 0, 0}},
                                               {{0, 0, 0}, {infinity, 0, 0}},
                                               {{nan, 0, 0}, {0, 0, 0}},
                                               {{0, 0, 0}, {1e6f, 0, 0}}})
                  .ok());
  EXPECT_EQ(grid.ToOctree()->size(), 0u);
  // A ray without length still has an end.
  EXPECT_TRUE(grid.InsertScan(std::vector<Ray>{{{1, 1, 1}, {1, 1, 1}}}).ok());
  EXPECT_EQ(At(*grid.ToOctree(), {1.01, 1.01, 1.01}), Cell::kOccupied);
}

TEST(OccupancyGrid, WhatIsSeenThroughBecomesFreeUpToWhatIsOccupied) {
  OccupancyGrid grid(kVoxel_m, {});
  ASSERT_TRUE(
      grid.InsertScan(std::vector<Ray>{{{0.98f, 0.98f, 0.02f}, {0.98f, 0.02f, 0.02f}}}).ok());
  ASSERT_TRUE(
      grid.FillSeenThrough(std::vector<Ray>{{{0.02f, 0.02f, 0.02f}, {2.02f, 0.02f, 0.02f}},
                                            {{0.02f, 0.48f, 0.02f}, {2.02f, 0.48f, 0.02f}, 0.5f}})
          .ok());
  const auto octree = grid.ToOctree();
  EXPECT_EQ(At(*octree, {0.02, 0.02, 0.02}), Cell::kFree);
  EXPECT_EQ(At(*octree, {0.93, 0.02, 0.02}), Cell::kFree);
  EXPECT_EQ(At(*octree, {0.98, 0.02, 0.02}), Cell::kOccupied);
  EXPECT_EQ(At(*octree, {1.03, 0.02, 0.02}), Cell::kUnknown);
  EXPECT_EQ(At(*octree, {1.48, 0.48, 0.02}), Cell::kFree);
  EXPECT_EQ(At(*octree, {1.58, 0.48, 0.02}), Cell::kUnknown);
  EXPECT_EQ(At(*octree, {0.5, 0.25, 0.02}), Cell::kUnknown);
}

TEST(OccupancyGrid, SeeingThroughLeavesOutWhatIsNotInTheMapAndHasItsLimit) {
  OccupancyGrid grid(kVoxel_m, {.max_blocks = 10});
  const float nan = std::nanf("");
  EXPECT_TRUE(grid.FillSeenThrough(std::vector<Ray>{{{0, 0, 0}, {nan, 0, 0}},
                                                    {{nan, 0, 0}, {0, 0, 0}},
                                                    {{1e6f, 0, 0}, {0, 0, 0}},
                                                    {{1, 1, 1}, {1, 1, 1}}})
                  .ok());
  EXPECT_EQ(grid.FillSeenThrough(std::vector<Ray>{{{0, 0, 0}, {0, 200, 0}}}).code(),
            absl::StatusCode::kResourceExhausted);
}

TEST(OccupancyConfig, IsValidated) {
  EXPECT_TRUE(OccupancyConfig{}.Validate().ok());
  EXPECT_FALSE(OccupancyConfig{.hit_log_odds = 0.0}.Validate().ok());
  EXPECT_FALSE(OccupancyConfig{.miss_log_odds = 0.4}.Validate().ok());
  EXPECT_FALSE(OccupancyConfig{.min_log_odds = std::nan("")}.Validate().ok());
  EXPECT_FALSE(OccupancyConfig{.max_log_odds = 1e9}.Validate().ok());
  EXPECT_FALSE(OccupancyConfig{.max_blocks = 0}.Validate().ok());
}

// A scan leaves out little of what its rays pass through one by one, and nothing else becomes
// known.
TEST(OccupancyGrid, RaysThatRunTogetherMarkTheWayOnce) {
  std::vector<Ray> rays;
  for (int column = 0; column < 360; ++column) {
    for (int ring = -10; ring <= 10; ++ring) {
      const float azimuth_rad = static_cast<float>(column) * 0.0174533f;
      const float elevation_rad = static_cast<float>(ring) * 0.0349f;
      const Eigen::Vector3f direction(std::cos(elevation_rad) * std::cos(azimuth_rad),
                                      std::cos(elevation_rad) * std::sin(azimuth_rad),
                                      std::sin(elevation_rad));
      rays.push_back({{0.013f, 0.021f, 0.017f}, 3.0f * direction});
    }
  }
  const auto known = [](const octomap::OcTree& octree) {
    octomap::OcTree leaves(octree);
    leaves.expand();
    std::set<VoxelKey> keys;
    for (auto leaf = leaves.begin_leafs(); leaf != leaves.end_leafs(); ++leaf) {
      keys.insert({leaf.getKey()[0], leaf.getKey()[1], leaf.getKey()[2]});
    }
    return keys;
  };
  OccupancyGrid together(kVoxel_m, {}), alone(kVoxel_m, {});
  ASSERT_TRUE(together.InsertScan(rays).ok());
  for (const Ray& ray : rays) ASSERT_TRUE(alone.InsertScan(std::vector<Ray>{ray}).ok());
  const std::set<VoxelKey> found = known(*together.ToOctree());
  const std::set<VoxelKey> all = known(*alone.ToOctree());
  EXPECT_GT(all.size(), 50000u);
  EXPECT_TRUE(std::includes(all.begin(), all.end(), found.begin(), found.end()));
  EXPECT_GT(static_cast<double>(found.size()), 0.85 * static_cast<double>(all.size()));
}

}  // namespace
}  // namespace soundmap::mapping
