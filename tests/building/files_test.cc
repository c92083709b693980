#include "building/files.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <tuple>

#include "building/point_cloud_file.h"

namespace soundmap::building {
namespace {

using ::testing::HasSubstr;

Building Block() {
  auto octree = std::make_shared<octomap::OcTree>(0.05);
  for (int x = 0; x < 9; ++x) {
    for (int y = 0; y < 8; ++y) {
      for (int z = 0; z < 12; ++z) {
        octree->setNodeValue(octomap::OcTreeKey(32768 + x, 32760 + y, 32768 + z),
                             x == 0 || y == 0 ? 3.5f : -2.0f);
      }
    }
  }
  octree->prune();
  return {octree, SliceFloorPlan(*octree, 0.2, 0.5).value()};
}

class FilesTest : public ::testing::Test {
 protected:
  FilesTest()
      : folder_(std::filesystem::path(::testing::TempDir()) /
                ::testing::UnitTest::GetInstance()->current_test_info()->name()) {
    std::filesystem::create_directories(folder_);
  }
  ~FilesTest() override { std::filesystem::remove_all(folder_); }

  std::string Write(const std::string& name, const std::string& bytes) {
    const std::string path = (folder_ / name).string();
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }

  std::filesystem::path folder_;
};

TEST_F(FilesTest, OctreesComeBackWithTheSameFloorPlan) {
  const Building building = Block();
  for (const auto& [name, format] :
       {std::pair{"block.bt", MapFormat::kBt}, std::pair{"BLOCK.OT", MapFormat::kOt}}) {
    const auto read = ImportBuilding(Write(name, ExportGeometry(building, format).value()), {});
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(read->floor_plan, building.floor_plan);
    EXPECT_EQ(read->octree->size(), building.octree->size());
  }
}

TEST_F(FilesTest, PointsAreTheCentresOfTheOccupiedVoxels) {
  const Building building = Block();
  std::set<std::tuple<int, int, int>> expected;
  for (int x = 0; x < 9; ++x) {
    for (int y = 0; y < 8; ++y) {
      for (int z = 0; z < 12; ++z) {
        if (x == 0 || y == 0) expected.emplace(x, y - 8, z);
      }
    }
  }
  for (const auto& points : {ParsePly(ExportGeometry(building, MapFormat::kPly).value()),
                             ParsePcd(ExportGeometry(building, MapFormat::kPcd).value())}) {
    ASSERT_TRUE(points.ok()) << points.status();
    EXPECT_EQ(points->size(), expected.size());
    std::set<std::tuple<int, int, int>> voxels;
    for (const Eigen::Vector3d& point : *points) {
      const Eigen::Vector3d index = point / 0.05 - Eigen::Vector3d::Constant(0.5);
      EXPECT_TRUE(index.isApprox(index.array().round().matrix(), 1e-4)) << index.transpose();
      voxels.emplace(std::lround(index.x()), std::lround(index.y()), std::lround(index.z()));
    }
    EXPECT_EQ(voxels, expected);
  }
}

TEST_F(FilesTest, RosMapIsReadWithItsPicture) {
  const Building building = Block();
  const RosMap map = ToRosMap(building.floor_plan, "plan.pgm");
  const std::string path = Write("plan.yaml", map.yaml);
  EXPECT_THAT(std::string(ImportBuilding(path, {}).status().message()), HasSubstr("plan.pgm"));
  Write("plan.pgm", map.pgm);
  const auto read = ImportBuilding(path, {});
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->octree, nullptr);
  EXPECT_EQ(read->floor_plan, building.floor_plan);
  EXPECT_EQ(ExportGeometry(*read, MapFormat::kBt).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST_F(FilesTest, ErrorsNameTheFile) {
  EXPECT_EQ(ImportBuilding((folder_ / "none.bt").string(), {}).status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_FALSE(ImportBuilding(folder_.string() + "/", {}).ok());
  std::filesystem::create_directories(folder_ / "folder.bt");
  EXPECT_FALSE(ImportBuilding((folder_ / "folder.bt").string(), {}).ok());
  for (const char* name : {"a.bt", "a.ot", "a.ply", "a.pcd", "a.yaml", "a.stl", "a"}) {
    const auto read = ImportBuilding(Write(name, "nonsense\n"), {});
    EXPECT_EQ(read.status().code(), absl::StatusCode::kInvalidArgument) << name;
    EXPECT_THAT(std::string(read.status().message()), HasSubstr(name));
  }
}

// OctoMap's own converter reads what is exported, if it is installed.
TEST_F(FilesTest, OctomapToolsReadTheExport) {
  if (std::system("command -v bt2vrml > /dev/null") != 0) {
    GTEST_SKIP() << "octomap-tools is not installed";
  }
  const std::string path = Write("block.bt", ExportGeometry(Block(), MapFormat::kBt).value());
  ASSERT_EQ(std::system(("bt2vrml " + path + " > /dev/null 2>&1").c_str()), 0);
  EXPECT_GT(std::filesystem::file_size(path + ".wrl"), 1000u);
  const std::string full = Write("block.ot", ExportGeometry(Block(), MapFormat::kOt).value());
  ASSERT_EQ(std::system(("convert_octree " + full + " " + full + ".bt > /dev/null 2>&1").c_str()),
            0);
  const auto converted = ImportBuilding(full + ".bt", {});
  ASSERT_TRUE(converted.ok()) << converted.status();
  EXPECT_EQ(converted->floor_plan, Block().floor_plan);
}

std::string SharedData() {
  const char* folder = std::getenv("SOUNDMAP_DATA");
  return folder ? folder : SOUNDMAP_SOURCE_DIR "/../shared/data";
}

TEST_F(FilesTest, RealOctreesGiveAFloorPlan) {
  const std::string data = SharedData();
  if (!std::filesystem::exists(data)) GTEST_SKIP() << "the shared data is not at " << data;
  const auto catec = ImportBuilding(data + "/catec/catec.bt", {});
  ASSERT_TRUE(catec.ok()) << catec.status();
  EXPECT_EQ(catec->octree->size(), 2867081u);
  EXPECT_GT(catec->floor_plan.width() * 0.05, 20.0);
  const auto freiburg = ImportBuilding(data + "/building_079/geb079.bt", {});
  ASSERT_TRUE(freiburg.ok()) << freiburg.status();
  EXPECT_EQ(freiburg->floor_plan.cell_size_m(), 0.08);
  // A corridor with rooms on both sides: most of what is known is free.
  int free = 0, occupied = 0;
  for (const Cell cell : freiburg->floor_plan.cells()) {
    free += cell == Cell::kFree;
    occupied += cell == Cell::kOccupied;
  }
  EXPECT_GT(free * 0.08 * 0.08, 100.0);
  EXPECT_GT(occupied * 0.08 * 0.08, 20.0);
}

}  // namespace
}  // namespace soundmap::building
