#include "sound_map/export.h"

#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <cstring>
#include <map>
#include <memory>
#include <sstream>

#include "sound_map/color_map.h"
#include "sound_map/sound_map.h"
#include "sound_map/sound_octree.h"
#include "tests/sound_map/random_evidence.h"

namespace soundmap::sound_map {
namespace {

using geometry::VoxelKey;

std::shared_ptr<const Snapshot> SomeSnapshot(int scans = 40) {
  const auto map = SoundMap::Create(PaperConfig()).value();
  for (const auto& scan : RandomScans(scans, 1500, 41)) {
    if (!map->Apply(scan).ok()) ADD_FAILURE();
  }
  return map->TakeSnapshot();
}

std::map<VoxelKey, Voxel> Voxels(const Snapshot& snapshot, std::uint32_t min_updates) {
  std::map<VoxelKey, Voxel> voxels;
  snapshot.ForEach([&](const VoxelKey& key, const Voxel& voxel) {
    if (voxel.update_count > min_updates) voxels[key] = voxel;
    return true;
  });
  return voxels;
}

VoxelKey KeyOf(const octomap::OcTreeKey& key) { return {key[0], key[1], key[2]}; }

TEST(Export, OcTreeHoldsTheLogOddsForOctoMapsOwnReader) {
  const auto snapshot = SomeSnapshot();
  for (const std::uint32_t min_updates : {0u, 3u}) {
    std::stringstream stream;
    ASSERT_TRUE(WriteOcTree(*snapshot, min_updates, stream).ok());
    const std::unique_ptr<octomap::AbstractOcTree> any(octomap::AbstractOcTree::read(stream));
    const auto* tree = dynamic_cast<octomap::OcTree*>(any.get());
    ASSERT_NE(tree, nullptr);
    EXPECT_DOUBLE_EQ(tree->getResolution(), 0.05);
    const auto expected = Voxels(*snapshot, min_updates);
    std::size_t leaves = 0;
    for (auto leaf = tree->begin_leafs(); leaf != tree->end_leafs(); ++leaf, ++leaves) {
      ASSERT_EQ(leaf.getDepth(), 16u);
      ASSERT_EQ(leaf->getLogOdds(), expected.at(KeyOf(leaf.getKey())).log_odds);
      const auto centre = geometry::PointFromKey(KeyOf(leaf.getKey()), 0.05);
      ASSERT_NEAR(leaf.getX(), centre.x(), 1e-6);
    }
    EXPECT_EQ(leaves, expected.size());
  }
}

TEST(Export, SoundOcTreeHoldsAllThreeFields) {
  const auto snapshot = SomeSnapshot();
  std::stringstream stream;
  ASSERT_TRUE(WriteSoundOcTree(*snapshot, 1, stream).ok());
  const std::unique_ptr<octomap::AbstractOcTree> any(octomap::AbstractOcTree::read(stream));
  const auto* tree = dynamic_cast<SoundOcTree*>(any.get());
  ASSERT_NE(tree, nullptr);
  const auto expected = Voxels(*snapshot, 1);
  std::size_t leaves = 0;
  std::uint32_t most_updates = 0;
  for (auto leaf = tree->begin_leafs(); leaf != tree->end_leafs(); ++leaf, ++leaves) {
    const Voxel voxel{leaf->getLogOdds(), leaf->update_count, leaf->last_update_ns};
    ASSERT_EQ(voxel, expected.at(KeyOf(leaf.getKey())));
    most_updates = std::max(most_updates, voxel.update_count);
  }
  EXPECT_EQ(leaves, expected.size());
  EXPECT_EQ(tree->getRoot()->update_count, most_updates);
}

TEST(Export, OccupancyHoldsTheVoxelsWithEnoughUpdates) {
  const auto snapshot = SomeSnapshot();
  std::stringstream stream;
  ASSERT_TRUE(WriteOccupancy(*snapshot, 2, stream).ok());
  octomap::OcTree tree(0.05);
  ASSERT_TRUE(tree.readBinary(stream));
  std::size_t occupied = 0;
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    ASSERT_TRUE(tree.isNodeOccupied(*leaf));
    occupied += std::size_t{1} << 3 * (16 - leaf.getDepth());
  }
  const auto expected = Voxels(*snapshot, 2);
  EXPECT_EQ(occupied, expected.size());
  for (const auto& [key, voxel] : expected) {
    ASSERT_NE(tree.search(octomap::OcTreeKey(key.x, key.y, key.z)), nullptr);
  }
}

TEST(Export, AnEmptyMapIsAnEmptyFile) {
  const auto snapshot = SoundMap::Create(PaperConfig()).value()->TakeSnapshot();
  std::stringstream ot;
  ASSERT_TRUE(WriteOcTree(*snapshot, 0, ot).ok());
  const std::unique_ptr<octomap::AbstractOcTree> any(octomap::AbstractOcTree::read(ot));
  ASSERT_NE(any, nullptr);
  EXPECT_EQ(any->size(), 0u);
  std::stringstream bt;
  ASSERT_TRUE(WriteOccupancy(*snapshot, 0, bt).ok());
  octomap::OcTree tree(0.05);
  EXPECT_TRUE(tree.readBinary(bt));
  std::stringstream full;
  EXPECT_TRUE(WriteSoundOcTree(*snapshot, 0, full).ok());
  std::stringstream ply;
  EXPECT_TRUE(WritePly(*snapshot, 0, ply).ok());
}

// The header, line by line, then the records, read as the format says and not by the writer's code.
template <typename T>
T Take(std::string& bytes) {
  T value;
  std::memcpy(&value, bytes.data(), sizeof(T));
  bytes.erase(0, sizeof(T));
  return value;
}

std::string CutHeader(std::string& bytes, const std::string& last_line) {
  const std::size_t end = bytes.find(last_line + "\n") + last_line.size() + 1;
  std::string header = bytes.substr(0, end);
  bytes.erase(0, end);
  return header;
}

TEST(Export, PlyHoldsOneVertexAVoxel) {
  const auto snapshot = SomeSnapshot(3);
  std::stringstream stream;
  ASSERT_TRUE(WritePly(*snapshot, 0, stream).ok());
  std::string bytes = stream.str();
  const std::string header = CutHeader(bytes, "end_header");
  EXPECT_EQ(header.rfind("ply\nformat binary_little_endian 1.0\n", 0), 0u);
  const auto voxels = Voxels(*snapshot, 0);
  EXPECT_NE(header.find("element vertex " + std::to_string(voxels.size()) + "\n"),
            std::string::npos);
  std::stringstream fields(header);
  std::vector<std::string> names;
  for (std::string word; fields >> word;) {
    if (word != "property") continue;
    std::string type, name;
    fields >> type >> name;
    names.push_back(type + " " + name);
  }
  EXPECT_EQ(names, (std::vector<std::string>{"float x", "float y", "float z", "float log_odds",
                                             "uint update_count", "double last_update_s",
                                             "uchar red", "uchar green", "uchar blue"}));
  ASSERT_EQ(bytes.size(), voxels.size() * (4 * 4 + 4 + 8 + 3));
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    const float x = Take<float>(bytes), y = Take<float>(bytes), z = Take<float>(bytes);
    const auto& voxel = voxels.at(*geometry::KeyFromPoint(Eigen::Vector3d(x, y, z), 0.05));
    ASSERT_EQ(Take<float>(bytes), voxel.log_odds);
    ASSERT_EQ(Take<std::uint32_t>(bytes), voxel.update_count);
    ASSERT_NEAR(Take<double>(bytes), voxel.last_update_ns * 1e-9, 1e-6);
    const Color color{Take<std::uint8_t>(bytes), Take<std::uint8_t>(bytes),
                      Take<std::uint8_t>(bytes)};
    ASSERT_EQ(color, ColorOfLogOdds(voxel.log_odds));
  }
}

TEST(Export, PcdHoldsOnePointAVoxel) {
  const auto snapshot = SomeSnapshot(3);
  std::stringstream stream;
  ASSERT_TRUE(WritePcd(*snapshot, 1, stream).ok());
  std::string bytes = stream.str();
  const std::string header = CutHeader(bytes, "DATA binary");
  const auto voxels = Voxels(*snapshot, 1);
  EXPECT_NE(header.find("POINTS " + std::to_string(voxels.size()) + "\n"), std::string::npos);
  EXPECT_NE(header.find("FIELDS x y z log_odds update_count last_update_ns\n"), std::string::npos);
  EXPECT_NE(header.find("SIZE 4 4 4 4 4 8\nTYPE F F F F U I\n"), std::string::npos);
  ASSERT_EQ(bytes.size(), voxels.size() * 28);
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    const float x = Take<float>(bytes), y = Take<float>(bytes), z = Take<float>(bytes);
    Voxel voxel;
    voxel.log_odds = Take<float>(bytes);
    voxel.update_count = Take<std::uint32_t>(bytes);
    voxel.last_update_ns = Take<std::int64_t>(bytes);
    ASSERT_EQ(voxel, voxels.at(*geometry::KeyFromPoint(Eigen::Vector3d(x, y, z), 0.05)));
  }
}

TEST(Export, AStreamThatFailsIsSaid) {
  const auto snapshot = SomeSnapshot(3);
  std::ostream broken(nullptr);
  EXPECT_FALSE(WriteOcTree(*snapshot, 0, broken).ok());
  EXPECT_FALSE(WritePly(*snapshot, 0, broken).ok());
  EXPECT_FALSE(WritePcd(*snapshot, 0, broken).ok());
}

// Lightness, by which the eye and a grey printer tell the colours apart, falls on either side of 0.
TEST(ColorMap, DarkensWithTheAmountOfEvidence) {
  const auto luma = [](double log_odds) {
    const Color color = ColorOfLogOdds(log_odds);
    return 0.2126 * color.red + 0.7152 * color.green + 0.0722 * color.blue;
  };
  for (double log_odds = 0.0; log_odds < kColorLimit_log_odds; log_odds += 0.5) {
    EXPECT_LE(luma(log_odds + 0.5), luma(log_odds));
    EXPECT_LE(luma(-log_odds - 0.5), luma(-log_odds));
  }
  EXPECT_LT(luma(kColorLimit_log_odds), luma(-kColorLimit_log_odds) - 40.0);
  EXPECT_EQ(ColorOfLogOdds(1e9), ColorOfLogOdds(kColorLimit_log_odds));
}

}  // namespace
}  // namespace soundmap::sound_map
