#include "building/octree_file.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

namespace soundmap::building {
namespace {

octomap::OcTree Tree(unsigned seed = 1) {
  octomap::OcTree octree(0.05);
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> key(32768 - 30, 32768 + 30);
  std::uniform_real_distribution<float> log_odds(-2.0f, 3.5f);
  for (int i = 0; i < 500; ++i) {
    octree.setNodeValue(octomap::OcTreeKey(key(random), key(random), key(random)),
                        log_odds(random));
  }
  return octree;
}

std::string Header(std::string_view first, std::string_view rest) {
  return std::string(first) + "\n" + std::string(rest) + "data\n";
}

TEST(OctreeFile, OtComesBackEqual) {
  const octomap::OcTree octree = Tree();
  const auto read = ParseOctree(OctreeToOt(octree));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_TRUE(**read == octree);
  EXPECT_EQ(OctreeToOt(**read), OctreeToOt(octree));
}

TEST(OctreeFile, BtKeepsWhatIsOccupiedFreeAndUnknown) {
  const octomap::OcTree octree = Tree();
  const auto read = ParseOctree(OctreeToBt(octree));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ((*read)->size(), octree.size());
  for (auto leaf = octree.begin_leafs(); leaf != octree.end_leafs(); ++leaf) {
    const auto* node = (*read)->search(leaf.getKey());
    ASSERT_NE(node, nullptr);
    EXPECT_EQ((*read)->isNodeOccupied(node), octree.isNodeOccupied(*leaf));
  }
}

TEST(OctreeFile, AnOddVoxelSizeIsKeptExactly) {
  octomap::OcTree octree(1.0 / 30.0);
  octree.setNodeValue(octomap::point3d(1.0f, 1.0f, 1.0f), 1.0f);
  EXPECT_EQ((*ParseOctree(OctreeToOt(octree)))->getResolution(), 1.0 / 30.0);
  EXPECT_EQ((*ParseOctree(OctreeToBt(octree)))->getResolution(), 1.0 / 30.0);
}

// OctoMap's own reader and writer, as every other program uses them.
TEST(OctreeFile, OctomapReadsOurFilesAndWeReadIts) {
  const octomap::OcTree octree = Tree();
  const std::string path = ::testing::TempDir() + "octree_file_test.bt";
  std::ofstream(path, std::ios::binary) << OctreeToBt(octree);
  octomap::OcTree foreign(0.1);
  ASSERT_TRUE(foreign.readBinary(path));
  EXPECT_EQ(foreign.size(), octree.size());
  EXPECT_EQ(foreign.getResolution(), 0.05);

  std::stringstream full;
  octree.write(full);
  const auto read = ParseOctree(full.str());
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_TRUE(**read == octree);
  std::filesystem::remove(path);
}

TEST(OctreeFile, EveryTruncationIsRefused) {
  const octomap::OcTree octree = Tree();
  for (const std::string& file : {OctreeToOt(octree), OctreeToBt(octree)}) {
    for (std::size_t size = 0; size < file.size(); size += size < 200 ? 1 : 37) {
      const auto read = ParseOctree(std::string_view(file).substr(0, size));
      ASSERT_EQ(read.status().code(), absl::StatusCode::kInvalidArgument) << size;
      ASSERT_FALSE(read.status().message().empty());
    }
  }
}

TEST(OctreeFile, FlippedBitsAreRefusedOrGiveATree) {
  const octomap::OcTree octree = Tree();
  std::mt19937 random(3);
  for (const std::string& file : {OctreeToOt(octree), OctreeToBt(octree)}) {
    for (int i = 0; i < 2000; ++i) {
      std::string damaged = file;
      damaged[random() % damaged.size()] ^= static_cast<char>(1 << random() % 8);
      const auto read = ParseOctree(damaged);
      if (read.ok()) {
        EXPECT_GT((*read)->size(), 0u);
      }
    }
  }
}

TEST(OctreeFile, RefusesHeadersThatCannotBe) {
  const std::string bt = "# Octomap OcTree binary file";
  const std::string zeros(1 << 16, '\xff');
  for (const std::string& file : {
           Header("hello", "id OcTree\nsize 9\nres 0.05\n"),
           Header(bt, "id OcTree\nres 0.05\n"),
           Header(bt, "id OcTree\nsize 9\n"),
           Header(bt, "size 9\nres 0.05\n"),
           Header(bt, "id ColorOcTree\nsize 9\nres 0.05\n"),
           Header(bt, "id OcTree\nsize 0\nres 0.05\n"),
           Header(bt, "id OcTree\nsize 18446744073709551615\nres 0.05\n"),
           Header(bt, "id OcTree\nsize -1\nres 0.05\n"),
           Header(bt, "id OcTree\nsize 9\nres 0\n"),
           Header(bt, "id OcTree\nsize 9\nres -0.05\n"),
           Header(bt, "id OcTree\nsize 9\nres nan\n"),
           Header(bt, "id OcTree\nsize 9\nres inf\n"),
           Header(bt, "id OcTree\nsize 9\nres 1e300\n"),
           bt + "\n" + std::string(100000, '#'),
           std::string(),
       }) {
    EXPECT_EQ(ParseOctree(file + zeros).status().code(), absl::StatusCode::kInvalidArgument)
        << file.substr(0, 100);
  }
}

// All children inner, for ever: a tree deeper than OctoMap's 16 levels.
TEST(OctreeFile, RefusesATreeThatIsTooDeep) {
  EXPECT_FALSE(
      ParseOctree(Header("# Octomap OcTree binary file", "id OcTree\nsize 60000000\nres 0.05\n") +
                  std::string(1 << 20, '\xff'))
          .ok());
  std::string full = Header("# Octomap OcTree file", "id OcTree\nsize 60\nres 0.05\n");
  for (int i = 0; i < 60; ++i) full += std::string("\0\0\0\0\1", 5);
  EXPECT_FALSE(ParseOctree(full).ok());
}

TEST(OctreeFile, RefusesLogOddsThatAreNotFinite) {
  octomap::OcTree octree(0.05);
  octree.setNodeValue(octomap::point3d(1.0f, 1.0f, 1.0f), std::nanf(""));
  EXPECT_FALSE(ParseOctree(OctreeToOt(octree)).ok());
}

}  // namespace
}  // namespace soundmap::building
