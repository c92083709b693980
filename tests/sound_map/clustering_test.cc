#include "sound_map/clustering.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <random>
#include <set>

namespace soundmap::sound_map {
namespace {

using geometry::VoxelKey;

VoxelKey At(int x, int y, int z) {
  return {static_cast<std::uint16_t>(1000 + x), static_cast<std::uint16_t>(1000 + y),
          static_cast<std::uint16_t>(1000 + z)};
}

TEST(LocalMaxima, OfAPyramidIsItsTop) {
  std::vector<VoxelKey> keys;
  std::vector<float> values;
  for (int x = -4; x <= 4; ++x) {
    for (int y = -4; y <= 4; ++y) {
      keys.push_back(At(x, y, 0));
      values.push_back(10.0f - std::max(std::abs(x - 1), std::abs(y + 2)) - 0.01f * (x + y));
    }
  }
  const auto maxima = FindLocalMaxima(keys, values);
  ASSERT_EQ(maxima.size(), 1u);
  EXPECT_EQ(maxima[0].centroid_key, Eigen::Vector3d(1001, 998, 1000));
}

TEST(LocalMaxima, APlateauIsOneMaximumAtItsCentre) {
  std::vector<VoxelKey> keys;
  std::vector<float> values;
  for (int x = 0; x < 20; ++x) {
    for (int y = 0; y < 5; ++y) {
      keys.push_back(At(x, y, x / 7));  // also across steps in height
      values.push_back((x >= 3 && x <= 9) || x == 15 ? 40.0f : 5.0f);
    }
  }
  const auto maxima = FindLocalMaxima(keys, values);
  ASSERT_EQ(maxima.size(), 2u);
  EXPECT_NEAR(maxima[0].centroid_key.x(), 1006.0, 1e-9);
  EXPECT_NEAR(maxima[0].centroid_key.y(), 1002.0, 1e-9);
  EXPECT_EQ(maxima[1].centroid_key, Eigen::Vector3d(1015, 1002, 1002));
}

// A plateau that touches anything higher, even by a corner, is none.
TEST(LocalMaxima, APlateauBesideAHigherVoxelIsNone) {
  std::vector<VoxelKey> keys = {At(0, 0, 0), At(1, 0, 0), At(2, 0, 0), At(3, 1, 1)};
  const auto maxima = FindLocalMaxima(keys, std::vector<float>{7, 7, 7, 8});
  ASSERT_EQ(maxima.size(), 1u);
  EXPECT_EQ(maxima[0].first_voxel, 3);
}

TEST(LocalMaxima, AgreeWithAFloodFillByDefinition) {
  std::mt19937 random(3);
  std::map<VoxelKey, float> field;
  for (int i = 0; i < 900; ++i) {
    field[At(static_cast<int>(random() % 12), static_cast<int>(random() % 12),
             static_cast<int>(random() % 9))] = static_cast<float>(random() % 5);
  }
  std::vector<VoxelKey> keys;
  std::vector<float> values;
  for (const auto& [key, value] : field) {
    keys.push_back(key);
    values.push_back(value);
  }
  const auto near = [](const VoxelKey& a, const VoxelKey& b) {
    return std::abs(a.x - b.x) <= 1 && std::abs(a.y - b.y) <= 1 && std::abs(a.z - b.z) <= 1;
  };
  // Labels spread until nothing changes; a label dies where a higher voxel is near.
  std::vector<int> label(keys.size());
  for (std::size_t i = 0; i < keys.size(); ++i) label[i] = static_cast<int>(i);
  for (bool changed = true; changed;) {
    changed = false;
    for (std::size_t i = 0; i < keys.size(); ++i) {
      for (std::size_t j = 0; j < keys.size(); ++j) {
        if (values[i] == values[j] && near(keys[i], keys[j]) && label[j] < label[i]) {
          label[i] = label[j];
          changed = true;
        }
      }
    }
  }
  std::set<int> expected(label.begin(), label.end());
  for (std::size_t i = 0; i < keys.size(); ++i) {
    for (std::size_t j = 0; j < keys.size(); ++j) {
      if (values[j] > values[i] && near(keys[i], keys[j])) expected.erase(label[i]);
    }
  }
  std::set<int> found;
  for (const auto& maximum : FindLocalMaxima(keys, values)) found.insert(maximum.first_voxel);
  EXPECT_EQ(found, expected);
  EXPECT_GT(expected.size(), 5u);
}

TEST(KMeans, FindsSeparatedClustersInClosedForm) {
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector3d> means(3, Eigen::Vector3d::Zero());
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform(-0.3, 0.3);
  const Eigen::Vector3d places[] = {{0, 0, 0}, {2, 0, 1}, {0, 3, 0}};
  for (int i = 0; i < 300; ++i) {
    points.push_back(places[i % 3] +
                     Eigen::Vector3d(uniform(random), uniform(random), uniform(random)));
    means[i % 3] += points.back() / 100.0;
  }
  const auto result = KMeans(points, {{0.5, 0.4, 0}, {1.5, 0.3, 0.5}, {0.4, 2, 0}}, 50);
  for (int c = 0; c < 3; ++c) EXPECT_LT((result.centres[c] - means[c]).norm(), 1e-12);
  for (int i = 0; i < 300; ++i) EXPECT_EQ(result.cluster_of_point[i], i % 3);
  EXPECT_LT(result.iterations, 50);
}

// At a fixed point every centre is the mean of its points and every point belongs to its nearest
// centre.
TEST(KMeans, EndsInAFixedPoint) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 3000; ++i) {
    points.emplace_back(std::round(4 * normal(random)) / 4, normal(random), 0.1 * normal(random));
  }
  const std::vector<Eigen::Vector3d> seeds(points.begin(), points.begin() + 37);
  const auto result = KMeans(points, seeds, 1000);
  ASSERT_LT(result.iterations, 1000);
  std::vector<Eigen::Vector3d> sums(seeds.size(), Eigen::Vector3d::Zero());
  std::vector<int> counts(seeds.size(), 0);
  for (std::size_t i = 0; i < points.size(); ++i) {
    int nearest = 0;
    for (std::size_t c = 1; c < seeds.size(); ++c) {
      if ((result.centres[c] - points[i]).squaredNorm() <
          (result.centres[nearest] - points[i]).squaredNorm()) {
        nearest = static_cast<int>(c);
      }
    }
    ASSERT_EQ(result.cluster_of_point[i], nearest);
    sums[nearest] += points[i];
    ++counts[nearest];
  }
  for (std::size_t c = 0; c < seeds.size(); ++c) {
    if (counts[c] > 0) {
      EXPECT_LT((result.centres[c] - sums[c] / counts[c]).norm(), 1e-12);
    }
  }
}

TEST(KMeans, NoSeedsNoPointsAndLonelySeeds) {
  EXPECT_TRUE(KMeans({}, {}, 10).centres.empty());
  const std::vector<Eigen::Vector3d> one = {{1, 1, 1}};
  const auto result = KMeans(one, {{0, 0, 0}, {9, 9, 9}}, 10);
  EXPECT_EQ(result.centres[0], one[0]);
  EXPECT_EQ(result.centres[1], Eigen::Vector3d(9, 9, 9));
}

}  // namespace
}  // namespace soundmap::sound_map
