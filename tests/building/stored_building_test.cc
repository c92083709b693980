#include "building/stored_building.h"

#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <random>

namespace soundmap::building {
namespace {

Building MakeBuilding() {
  auto octree = std::make_shared<octomap::OcTree>(0.05);
  std::mt19937 random(1);
  for (int i = 0; i < 300; ++i) {
    octree->setNodeValue(
        octomap::OcTreeKey(32768 + random() % 20, 32768 + random() % 20, 32768 + random() % 20),
        random() % 2 ? 1.25f : -0.5f);
  }
  FloorPlan plan(5, 4, 0.05, Eigen::Vector2d(-1.0 / 3.0, 0.1));
  for (int i = 0; i < 20; ++i) plan.at(i % 5, i / 5) = static_cast<Cell>(i % 3);
  return {octree, plan};
}

TEST(StoredBuilding, ComesBackEqualAndAsTheSameBytes) {
  const Building building = MakeBuilding();
  const std::string bytes = SerializeBuilding(building);
  EXPECT_EQ(bytes, SerializeBuilding(building));
  const auto read = ParseBuilding(bytes);
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_NE(read->octree, nullptr);
  EXPECT_TRUE(*read->octree == *building.octree);
  EXPECT_EQ(read->floor_plan, building.floor_plan);
  EXPECT_EQ(SerializeBuilding(*read), bytes);
}

TEST(StoredBuilding, TheOctreeMayBeAbsent) {
  Building building = MakeBuilding();
  building.octree = nullptr;
  const auto read = ParseBuilding(SerializeBuilding(building));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->octree, nullptr);
  EXPECT_EQ(read->floor_plan, building.floor_plan);
}

// Content that compresses as well as any is no damage.
TEST(StoredBuilding, AWidePlanOfWhichNothingIsKnownComesBack) {
  const Building building{nullptr, FloorPlan(5000, 4000, 0.05, {0.0, 0.0})};
  const std::string bytes = SerializeBuilding(building);
  EXPECT_LT(bytes.size(), 5000u);
  const auto read = ParseBuilding(bytes);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_TRUE(read->floor_plan == building.floor_plan);
}

TEST(StoredBuilding, RefusesDamageAndNewerVersions) {
  const std::string bytes = SerializeBuilding(MakeBuilding());
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_EQ(ParseBuilding(std::string_view(bytes).substr(0, size)).status().code(),
              absl::StatusCode::kDataLoss)
        << size;
  }
  // The zstd frame's checksum finds every flipped bit that changes the content.
  int refused = 0;
  for (std::size_t i = 40; i < bytes.size(); i += 3) {
    std::string damaged = bytes;
    damaged[i] ^= 0x10;
    const auto read = ParseBuilding(damaged);
    EXPECT_TRUE(!read.ok() || SerializeBuilding(*read) == bytes) << i;
    refused += !read.ok();
  }
  EXPECT_GT(refused, static_cast<int>(bytes.size()) / 4);
  std::string newer = bytes;
  newer[8] = 2;
  EXPECT_EQ(ParseBuilding(newer).status().code(), absl::StatusCode::kUnimplemented);
}

}  // namespace
}  // namespace soundmap::building
