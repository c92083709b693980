#include "building/point_cloud.h"

#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <utility>

#include "building/point_cloud_file.h"

namespace soundmap::building {
namespace {

using Eigen::Vector3d;
using Points = std::vector<Vector3d>;

template <typename Number>
void Append(std::string& bytes, Number number) {
  bytes.append(reinterpret_cast<const char*>(&number), sizeof number);
}

TEST(PointCloudFile, AsciiPlyWithFieldsInAnyOrder) {
  const auto points = ParsePly(
      "ply\r\nformat ascii 1.0\r\ncomment made by hand\r\nelement vertex 3\r\n"
      "property uchar red\r\nproperty double z\r\nproperty float x\r\nproperty float y\r\n"
      "element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
      "255 3 1 2\r\n\r\n0 6.5 4e0 -5\r\n0 nan 1 1\r\n3 0 1 2\r\n");
  ASSERT_TRUE(points.ok()) << points.status();
  EXPECT_EQ(*points, (Points{{1, 2, 3}, {4, -5, 6.5}}));
}

TEST(PointCloudFile, BinaryPlyWithMixedTypes) {
  std::string ply =
      "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty short intensity\n"
      "property double y\nproperty int z\nproperty float x\nproperty uchar label\nend_header\n";
  for (int i = 0; i < 2; ++i) {
    Append(ply, std::int16_t{77});
    Append(ply, 0.1 + i);
    Append(ply, std::int32_t{-3 - i});
    Append(ply, 1.5f + i);
    Append(ply, std::uint8_t{9});
  }
  const auto points = ParsePly(ply);
  ASSERT_TRUE(points.ok()) << points.status();
  EXPECT_EQ(*points, (Points{{1.5, 0.1, -3}, {2.5, 1.1, -4}}));
}

TEST(PointCloudFile, AsciiAndBinaryPcd) {
  const auto ascii = ParsePcd(
      "# .PCD v.7\nVERSION .7\nFIELDS normal x y z\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 3 1 1 1\n"
      "WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n"
      "0 0 1 1 2 3\n0 0 1 nan nan nan\n");
  ASSERT_TRUE(ascii.ok()) << ascii.status();
  EXPECT_EQ(*ascii, (Points{{1, 2, 3}}));

  std::string binary =
      "VERSION .7\nFIELDS rgb z y x\nSIZE 4 8 8 8\nTYPE U F F F\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n"
      "DATA binary\n";
  Append(binary, std::uint32_t{0});
  for (const double value : {3.25, 2.25, 1.25}) Append(binary, value);
  const auto points = ParsePcd(binary);
  ASSERT_TRUE(points.ok()) << points.status();
  EXPECT_EQ(*points, (Points{{1.25, 2.25, 3.25}}));
}

TEST(PointCloudFile, WhatIsWrittenIsRead) {
  const Points points = {{0.025, -1.475, 2.625}, {1e3, 0, -1e-3}};
  for (const auto& read : {ParsePly(PointsToPly(points)), ParsePcd(PointsToPcd(points))}) {
    ASSERT_TRUE(read.ok()) << read.status();
    ASSERT_EQ(read->size(), 2u);
    for (int i = 0; i < 2; ++i) EXPECT_TRUE((*read)[i].isApprox(points[i], 1e-6));
  }
}

TEST(PointCloudFile, EveryTruncationIsRefused) {
  const Points points = {{1, 2, 3}, {4, 5, 6}};
  const std::string ply = PointsToPly(points);
  const std::string pcd = PointsToPcd(points);
  const std::string ascii =
      "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
      "property float z\nend_header\n1 2 3\n4 5 ";
  for (std::size_t size = 0; size < ply.size(); ++size) {
    EXPECT_FALSE(ParsePly(std::string_view(ply).substr(0, size)).ok()) << size;
  }
  for (std::size_t size = 0; size < pcd.size(); ++size) {
    EXPECT_FALSE(ParsePcd(std::string_view(pcd).substr(0, size)).ok()) << size;
  }
  for (std::size_t size = 0; size <= ascii.size(); ++size) {
    EXPECT_FALSE(ParsePly(std::string_view(ascii).substr(0, size)).ok()) << size;
  }
}

TEST(PointCloudFile, RefusesWhatItCannotRead) {
  const std::string xyz = "property float x\nproperty float y\nproperty float z\nend_header\n";
  const std::string bytes(64, '\0');
  for (const std::string& ply : {
           "ply\nformat binary_big_endian 1.0\nelement vertex 1\n" + xyz + bytes,
           "ply\nformat binary_little_endian 1.0\nelement vertex 18446744073709551615\n" + xyz,
           "ply\nformat ascii 1.0\nelement vertex 100000000\n" + xyz + bytes,
           "ply\nformat binary_little_endian 1.0\nelement vertex -1\n" + xyz + bytes,
           "ply\nformat binary_little_endian 1.0\n" + xyz + bytes,
           "ply\nformat ascii 1.0\nelement vertex 0\n" + xyz,
           "ply\nformat ascii 1.0\nelement vertex 1\n" + xyz + "1 2 three\n",
           "ply\nformat ascii 1.0\nelement vertex 1\n" + xyz + "nan inf 0\n",
           std::string(
               "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"),
           std::string("ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\n") +
               xyz,
           "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int i\n" + xyz,
           std::string("solid\n"),
       }) {
    EXPECT_EQ(ParsePly(ply).status().code(), absl::StatusCode::kInvalidArgument) << ply;
  }
  const std::string fields = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\n";
  for (const std::string& pcd : {
           fields + "POINTS 1\nDATA binary_compressed\n" + bytes,
           fields + "POINTS 4000000000\nDATA binary\n" + bytes,
           fields + "DATA binary\n" + bytes,
           "FIELDS x y z\nSIZE 4 4\nTYPE F F F\nPOINTS 1\nDATA binary\n" + bytes,
           "FIELDS x y z\nSIZE 3 4 4\nTYPE F F F\nPOINTS 1\nDATA binary\n" + bytes,
           "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 18446744073709551615\nPOINTS 1\n"
           "DATA binary\n" +
               bytes,
           std::string("POINTS 1\nDATA ascii\n1 2 3\n"),
           std::string("\n\n"),
       }) {
    EXPECT_EQ(ParsePcd(pcd).status().code(), absl::StatusCode::kInvalidArgument) << pcd;
  }
}

constexpr double kStep_m = 0.05;

// Walls of a 3 m x 2 m room up to 1 m height, and its floor on request.
Points Room(bool floor) {
  Points points;
  for (double x = 0.025; x < 3.0; x += kStep_m) {
    for (double z = 0.025; z < 1.0; z += kStep_m) {
      points.emplace_back(x, 0.025, z);
      points.emplace_back(x, 1.975, z);
    }
  }
  for (double y = 0.025; y < 2.0; y += kStep_m) {
    for (double z = 0.025; z < 1.0; z += kStep_m) {
      points.emplace_back(0.025, y, z);
      points.emplace_back(2.975, y, z);
    }
  }
  if (floor) {
    // Rings with holes of three cells between them.
    for (double x = 0.125; x < 2.95; x += 4 * kStep_m) {
      for (double y = 0.075; y < 1.95; y += kStep_m) points.emplace_back(x, y, 0.025);
    }
  }
  return points;
}

TEST(BuildingFromPoints, TheInsideIsFreeWithAndWithoutAFloor) {
  for (const bool floor : {true, false}) {
    const auto building = BuildingFromPoints(Room(floor), {});
    ASSERT_TRUE(building.ok()) << building.status();
    const FloorPlan& plan = building->floor_plan;
    ASSERT_EQ(plan.width(), 60);
    ASSERT_EQ(plan.height(), 40);
    for (int row = 0; row < 40; ++row) {
      for (int column = 0; column < 60; ++column) {
        const bool wall = row == 0 || row == 39 || column == 0 || column == 59;
        // The first and the last ring of the floor have no second side to be filled to.
        if (!wall && (column < 3 || column > 56)) continue;
        EXPECT_EQ(plan.at(column, row), wall ? Cell::kOccupied : Cell::kFree)
            << column << ", " << row << (floor ? " with floor" : " without floor");
      }
    }
  }
}

TEST(BuildingFromPoints, AirEndsAtTheNextPointAbove) {
  Points points = {{0.025, 0.025, 0.025}, {0.025, 0.025, 0.525}, {0.025, 0.025, 1.025}};
  points.emplace_back(1.025, 0.025, 0.025);
  const auto building = BuildingFromPoints(points, {});
  ASSERT_TRUE(building.ok()) << building.status();
  const auto occupancy = [&](double x, double z) {
    const auto* node = building->octree->search(x, 0.025, z);
    if (!node) return Cell::kUnknown;
    return building->octree->isNodeOccupied(node) ? Cell::kOccupied : Cell::kFree;
  };
  EXPECT_EQ(occupancy(0.025, -0.025), Cell::kUnknown);
  EXPECT_EQ(occupancy(0.025, 0.025), Cell::kOccupied);
  EXPECT_EQ(occupancy(0.025, 0.275), Cell::kFree);
  EXPECT_EQ(occupancy(0.025, 0.525), Cell::kOccupied);
  EXPECT_EQ(occupancy(0.025, 0.775), Cell::kUnknown);
  EXPECT_EQ(occupancy(1.025, 1.975), Cell::kFree);
  EXPECT_EQ(occupancy(1.025, 2.075), Cell::kUnknown);
}

TEST(BuildingFromPoints, HolesAreNotFilledThroughAWall) {
  // Floor on both sides of a wall that is two cells thick with an unknown core.
  Points points;
  for (double x = 0.025; x < 0.4; x += kStep_m) points.emplace_back(x, 0.025, 0.025);
  for (double x = 0.625; x < 1.0; x += kStep_m) points.emplace_back(x, 0.025, 0.025);
  points.emplace_back(0.425, 0.025, 0.325);
  points.emplace_back(0.575, 0.025, 0.325);
  const auto building = BuildingFromPoints(points, {});
  ASSERT_TRUE(building.ok()) << building.status();
  EXPECT_EQ(building->floor_plan.at(7, 0), Cell::kFree);
  EXPECT_EQ(building->floor_plan.at(8, 0), Cell::kOccupied);
  EXPECT_EQ(building->floor_plan.at(9, 0), Cell::kUnknown);
  EXPECT_EQ(building->floor_plan.at(10, 0), Cell::kUnknown);
  EXPECT_EQ(building->floor_plan.at(11, 0), Cell::kOccupied);
}

// Points at the centres of random cells of a square, in each with this chance, and at its corners.
Points Scattered(int seed, int cells, double chance, double height_m) {
  std::mt19937 random(seed);
  std::bernoulli_distribution there(chance);
  Points points;
  for (int row = 0; row < cells; ++row) {
    for (int column = 0; column < cells; ++column) {
      const bool corner = (row == 0 || row == cells - 1) && (column == 0 || column == cells - 1);
      if (!there(random) && !corner) continue;
      points.emplace_back((column + 0.5) * kStep_m, (row + 0.5) * kStep_m, height_m);
    }
  }
  return points;
}

FloorPlan Drawn(const Points& occupied, const Points& free, int cells) {
  FloorPlan plan(cells, cells, kStep_m, {0.0, 0.0});
  for (const auto& [points, cell] :
       {std::pair(&free, Cell::kFree), std::pair(&occupied, Cell::kOccupied)}) {
    for (const Vector3d& point : *points) {
      plan.at(static_cast<int>(point.x() / kStep_m), static_cast<int>(point.y() / kStep_m)) = cell;
    }
  }
  return plan;
}

// From every unknown cell on its own: the nearest known ones before and behind it.
TEST(BuildingFromPoints, GapsAreFilledAsTheirCellsSay) {
  constexpr int kCells = 40;
  constexpr int kGap_cells = 8;  // PointCloudConfig's 0.4 m
  for (int seed = 0; seed < 20; ++seed) {
    const Points walls = Scattered(seed, kCells, 0.03, 0.325);
    Points floor = Scattered(100 + seed, kCells, 0.1, 0.025);
    FloorPlan expected = Drawn(walls, floor, kCells);
    for (const auto& [across, up] : {std::pair(1, 0), std::pair(0, 1)}) {
      const FloorPlan before = expected;
      const auto nearest = [&](int column, int row, int step) {
        int cells = 0;
        do {
          column += step * across;
          row += step * up;
          ++cells;
        } while (before.Contains(column, row) && before.at(column, row) == Cell::kUnknown);
        const bool free = before.Contains(column, row) && before.at(column, row) == Cell::kFree;
        return free ? cells : 2 * kCells;
      };
      for (int row = 0; row < kCells; ++row) {
        for (int column = 0; column < kCells; ++column) {
          if (before.at(column, row) != Cell::kUnknown) continue;
          const int gap = nearest(column, row, 1) + nearest(column, row, -1) - 1;
          if (gap <= kGap_cells) expected.at(column, row) = Cell::kFree;
        }
      }
    }
    floor.insert(floor.end(), walls.begin(), walls.end());
    const auto building = BuildingFromPoints(floor, {});
    ASSERT_TRUE(building.ok()) << building.status();
    EXPECT_TRUE(building->floor_plan.cells() == expected.cells()) << "seed " << seed;
  }
}

// Cell by cell until nothing changes.
TEST(BuildingFromPoints, WithoutAFloorIsFreeWhatNoWayLeadsOutOf) {
  constexpr int kCells = 40;
  for (int seed = 0; seed < 20; ++seed) {
    const Points walls = Scattered(seed, kCells, 0.42, 0.325);
    FloorPlan expected = Drawn(walls, {}, kCells);
    std::vector<bool> outside(kCells * kCells, false);
    const auto is_outside = [&](int column, int row) {
      return !expected.Contains(column, row) || outside[row * kCells + column];
    };
    for (bool changed = true; changed;) {
      changed = false;
      for (int row = 0; row < kCells; ++row) {
        for (int column = 0; column < kCells; ++column) {
          if (expected.at(column, row) != Cell::kUnknown || is_outside(column, row)) continue;
          if (!is_outside(column - 1, row) && !is_outside(column + 1, row) &&
              !is_outside(column, row - 1) && !is_outside(column, row + 1)) {
            continue;
          }
          changed = outside[row * kCells + column] = true;
        }
      }
    }
    for (int row = 0; row < kCells; ++row) {
      for (int column = 0; column < kCells; ++column) {
        Cell& cell = expected.at(column, row);
        if (cell == Cell::kUnknown && !is_outside(column, row)) cell = Cell::kFree;
      }
    }
    const auto building = BuildingFromPoints(walls, {});
    ASSERT_TRUE(building.ok()) << building.status();
    EXPECT_TRUE(building->floor_plan.cells() == expected.cells()) << "seed " << seed;
  }
}

TEST(BuildingFromPoints, RefusesWhatHasNoFreeSpaceOrLiesOutside) {
  EXPECT_FALSE(BuildingFromPoints(Points{{0, 0, 0.3}}, {}).ok());
  EXPECT_FALSE(BuildingFromPoints(Points{{1e9, 0, 0.3}}, {}).ok());
  EXPECT_FALSE(BuildingFromPoints(Points{}, {}).ok());
  for (PointCloudConfig config :
       {PointCloudConfig{.voxel_size_m = 0.0}, PointCloudConfig{.floor_height_m = std::nan("")},
        PointCloudConfig{.floor_tolerance_m = -1.0}, PointCloudConfig{.air_height_m = 1e9},
        PointCloudConfig{.floor_gap_m = std::nan("")},
        PointCloudConfig{.slice_min_height_m = 3.0}}) {
    EXPECT_FALSE(BuildingFromPoints(Room(true), config).ok());
  }
}

}  // namespace
}  // namespace soundmap::building
