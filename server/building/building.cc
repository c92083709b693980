#include "building/building.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "absl/strings/str_format.h"

namespace soundmap::building {
namespace {

constexpr int kDepth = 16;
constexpr int kCentre = 32768;

// Heights on the boundary of two voxels do not reach into the further one because of rounding.
constexpr double kBoundaryTolerance_voxels = 1e-6;

struct KeyRange {
  int begin = 65536;  // inclusive
  int end = 0;        // exclusive

  void Extend(int other_begin, int other_end) {
    begin = std::min(begin, other_begin);
    end = std::max(end, other_end);
  }
};

// A leaf at any depth as the cube of lowest-level voxels that it stands for.
struct Cube {
  int x, y, z, size;
  bool occupied;
};

template <typename Visit>
void ForEachLeafBetween(const octomap::OcTree& octree, int z_begin, int z_end, Visit visit) {
  for (auto leaf = octree.begin_leafs(), end = octree.end_leafs(); leaf != end; ++leaf) {
    const octomap::OcTreeKey key = leaf.getIndexKey();
    const Cube cube{key[0], key[1], key[2], 1 << (kDepth - static_cast<int>(leaf.getDepth())),
                    octree.isNodeOccupied(*leaf)};
    if (cube.z < z_end && cube.z + cube.size > z_begin) visit(cube);
  }
}

}  // namespace

absl::StatusOr<FloorPlan> SliceFloorPlan(const octomap::OcTree& octree, double min_height_m,
                                         double max_height_m) {
  if (!(std::isfinite(min_height_m) && std::isfinite(max_height_m) &&
        min_height_m <= max_height_m)) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "the floor plan's heights %g m to %g m are not in order", min_height_m, max_height_m));
  }
  const double voxel_size_m = octree.getResolution();
  const auto key = [](double voxels) {
    return static_cast<int>(std::clamp(voxels + kCentre, 0.0, 65536.0));
  };
  const int z_begin = key(std::floor(min_height_m / voxel_size_m + kBoundaryTolerance_voxels));
  const int z_end = std::max(
      z_begin + 1, key(std::ceil(max_height_m / voxel_size_m - kBoundaryTolerance_voxels)));

  KeyRange x, y;
  ForEachLeafBetween(octree, z_begin, z_end, [&](const Cube& cube) {
    x.Extend(cube.x, cube.x + cube.size);
    y.Extend(cube.y, cube.y + cube.size);
  });
  if (x.begin >= x.end) {
    return absl::InvalidArgumentError(
        absl::StrFormat("nothing is known of the building between the heights %g m and %g m, so it "
                        "has no floor plan",
                        min_height_m, max_height_m));
  }
  const int width = x.end - x.begin;
  const int height = y.end - y.begin;
  if (std::int64_t{width} * height > kMaxFloorPlanCells) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "the building's floor plan would have %d x %d cells of %g m, more than the limit of %d",
        width, height, voxel_size_m, kMaxFloorPlanCells));
  }

  FloorPlan floor_plan(
      width, height, voxel_size_m,
      Eigen::Vector2d((x.begin - kCentre) * voxel_size_m, (y.begin - kCentre) * voxel_size_m));
  ForEachLeafBetween(octree, z_begin, z_end, [&](const Cube& cube) {
    for (int row = cube.y - y.begin; row < cube.y + cube.size - y.begin; ++row) {
      for (int column = cube.x - x.begin; column < cube.x + cube.size - x.begin; ++column) {
        Cell& cell = floor_plan.at(column, row);
        cell = std::max(cell, cube.occupied ? Cell::kOccupied : Cell::kFree);
      }
    }
  });
  return floor_plan;
}

}  // namespace soundmap::building
