#include "sound_map/place_index.h"

#include <gtest/gtest.h>

#include <random>

namespace soundmap::sound_map {
namespace {

constexpr double kVoxel_m = 0.05;
constexpr double kRadius_m = 0.3;

// Against every place in turn.
TEST(PlaceIndex, FindsTheNearestPlaceWithinTheRadius) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const auto point = [&] {
    return Eigen::Vector3d(1.5 * uniform(random), 1.5 * uniform(random), uniform(random));
  };
  PlaceIndex index(kRadius_m, kVoxel_m);
  int found = 0;
  int none = 0;
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<Eigen::Vector3d> places;
    for (int i = 0; i < 4 * trial; ++i) places.push_back(point());
    index.Set(places);  // forgets those of before
    for (int i = 0; i < 2000; ++i) {
      const geometry::VoxelKey key = *geometry::KeyFromPoint(point(), kVoxel_m);
      const Eigen::Vector3d centre = geometry::PointFromKey(key, kVoxel_m);
      std::optional<int> nearest;
      for (int p = 0; p < static_cast<int>(places.size()); ++p) {
        const double distance_m = (places[p] - centre).norm();
        if (distance_m <= kRadius_m &&
            (!nearest || distance_m < (places[*nearest] - centre).norm())) {
          nearest = p;
        }
      }
      ASSERT_EQ(index.Nearest(key), nearest);
      ASSERT_TRUE(!nearest || index.MayBeNear(key));
      ++(nearest ? found : none);
    }
  }
  EXPECT_GT(found, 1000);
  EXPECT_GT(none, 1000);
}

TEST(PlaceIndex, OutsideTheOctreeNothingIsNear) {
  const geometry::VoxelKey corner{65535, 65535, 65535};
  PlaceIndex index(kRadius_m, kVoxel_m);
  index.Set({geometry::PointFromKey(corner, kVoxel_m), Eigen::Vector3d::Constant(1e9),
             Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN())});
  EXPECT_EQ(index.Nearest(corner), std::nullopt);
  EXPECT_EQ(index.Nearest({0, 0, 0}), std::nullopt);
}

}  // namespace
}  // namespace soundmap::sound_map
