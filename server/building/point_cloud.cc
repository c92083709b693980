#include "building/point_cloud.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "geometry/voxel_key.h"

namespace soundmap::building {
namespace {

using geometry::VoxelKey;

octomap::OcTreeKey ToOctomap(const VoxelKey& key) { return {key.x, key.y, key.z}; }

// Unknown runs of at most `max_cells` between two free cells of a row become free, then those of a
// column. Goes through the plan in the order of its rows, for its cells may be many.
void FillGaps(FloorPlan& plan, int max_cells) {
  for (int row = 0; row < plan.height(); ++row) {
    int last_free = -1;
    for (int column = 0; column < plan.width(); ++column) {
      const Cell cell = plan.at(column, row);
      if (cell == Cell::kOccupied) last_free = -1;
      if (cell != Cell::kFree) continue;
      if (last_free >= 0 && column - last_free - 1 <= max_cells) {
        for (int gap = last_free + 1; gap < column; ++gap) plan.at(gap, row) = Cell::kFree;
      }
      last_free = column;
    }
  }
  std::vector<int> last_free(plan.width(), -1);  // row of each column
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      const Cell cell = plan.at(column, row);
      int& last = last_free[column];
      if (cell == Cell::kOccupied) last = -1;
      if (cell != Cell::kFree) continue;
      if (last >= 0 && row - last - 1 <= max_cells) {
        for (int gap = last + 1; gap < row; ++gap) plan.at(column, gap) = Cell::kFree;
      }
      last = row;
    }
  }
}

// Unknown cells that no path over unknown cells joins to the plan's border become free. Floods by
// runs of a row, of which there are no more than rows and occupied cells.
void FillEnclosed(FloorPlan& plan) {
  struct Run {
    int row, first, last;
  };
  std::vector<bool> outside(plan.cells().size(), false);
  const auto index = [&](int column, int row) {
    return static_cast<std::size_t>(row) * plan.width() + column;
  };
  const auto is_reachable = [&](int column, int row) {
    return plan.Contains(column, row) && plan.at(column, row) == Cell::kUnknown &&
           !outside[index(column, row)];
  };
  std::vector<Run> open;
  const auto reach = [&](int column, int row) {
    if (!is_reachable(column, row)) return;
    Run run{row, column, column};
    while (is_reachable(run.first - 1, row)) --run.first;
    while (is_reachable(run.last + 1, row)) ++run.last;
    for (int i = run.first; i <= run.last; ++i) outside[index(i, row)] = true;
    open.push_back(run);
  };
  for (int column = 0; column < plan.width(); ++column) {
    reach(column, 0);
    reach(column, plan.height() - 1);
  }
  for (int row = 0; row < plan.height(); ++row) {
    reach(0, row);
    reach(plan.width() - 1, row);
  }
  while (!open.empty()) {
    const Run run = open.back();
    open.pop_back();
    for (int column = run.first; column <= run.last; ++column) {
      reach(column, run.row - 1);
      reach(column, run.row + 1);
    }
  }
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      if (plan.at(column, row) == Cell::kUnknown && !outside[index(column, row)]) {
        plan.at(column, row) = Cell::kFree;
      }
    }
  }
}

bool HasFreeCell(const FloorPlan& plan) {
  return std::find(plan.cells().begin(), plan.cells().end(), Cell::kFree) != plan.cells().end();
}

// Occupied voxels sorted by column, upwards, none twice.
absl::StatusOr<std::vector<VoxelKey>> OccupiedVoxels(std::span<const Eigen::Vector3d> point_in_map,
                                                     double voxel_size_m) {
  std::vector<VoxelKey> occupied;
  occupied.reserve(point_in_map.size());
  for (const Eigen::Vector3d& point : point_in_map) {
    const auto key = geometry::KeyFromPoint(point, voxel_size_m);
    if (!key) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "the point cloud's point (%g, %g, %g) lies outside the map, which reaches %g m from its "
          "origin",
          point.x(), point.y(), point.z(), voxel_size_m * VoxelKey::kCentre));
    }
    occupied.push_back(*key);
  }
  std::sort(occupied.begin(), occupied.end());
  occupied.erase(std::unique(occupied.begin(), occupied.end()), occupied.end());
  return occupied;
}

// Free voxels between a floor voxel and what is above it in its column.
std::vector<VoxelKey> AirAboveFloor(const std::vector<VoxelKey>& occupied,
                                    const PointCloudConfig& config) {
  const auto level = [&](double height_m) {
    const double voxels = std::floor(height_m / config.voxel_size_m) + VoxelKey::kCentre;
    return static_cast<int>(std::clamp(voxels, 0.0, 65535.0));
  };
  const int floor_min = level(config.floor_height_m - config.floor_tolerance_m);
  const int floor_max = level(config.floor_height_m + config.floor_tolerance_m);
  const int air_max = level(config.floor_height_m + config.air_height_m);
  std::vector<VoxelKey> air;
  for (std::size_t i = 0; i < occupied.size(); ++i) {
    const VoxelKey& below = occupied[i];
    if (below.z < floor_min || below.z > floor_max) continue;
    const bool covered =
        i + 1 < occupied.size() && occupied[i + 1].x == below.x && occupied[i + 1].y == below.y;
    const int end = covered ? occupied[i + 1].z : air_max + 1;
    for (int z = below.z + 1; z < end; ++z) {
      air.push_back({below.x, below.y, static_cast<std::uint16_t>(z)});
    }
  }
  return air;
}

}  // namespace

absl::Status PointCloudConfig::Validate() const {
  if (!(voxel_size_m >= 0.005 && voxel_size_m <= 1.0)) {
    return absl::InvalidArgumentError("the point cloud's voxel_size_m must be from 0.005 to 1 m");
  }
  if (!std::isfinite(floor_height_m) || std::abs(floor_height_m) > 1000.0) {
    return absl::InvalidArgumentError("the point cloud's floor_height_m must be within 1000 m");
  }
  for (const auto& [name, value_m] :
       {std::pair{"floor_tolerance_m", floor_tolerance_m}, std::pair{"air_height_m", air_height_m},
        std::pair{"floor_gap_m", floor_gap_m}}) {
    if (!(value_m >= 0.0 && value_m <= 20.0)) {
      return absl::InvalidArgumentError(
          absl::StrFormat("the point cloud's %s must be from 0 to 20 m", name));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<Building> BuildingFromPoints(std::span<const Eigen::Vector3d> point_in_map,
                                            const PointCloudConfig& config) {
  if (const absl::Status status = config.Validate(); !status.ok()) return status;
  const auto occupied = OccupiedVoxels(point_in_map, config.voxel_size_m);
  if (!occupied.ok()) return occupied.status();

  auto octree = std::make_shared<octomap::OcTree>(config.voxel_size_m);
  for (const VoxelKey& key : AirAboveFloor(*occupied, config)) {
    octree->setNodeValue(ToOctomap(key), octree->getClampingThresMinLog(), /*lazy_eval=*/true);
  }
  for (const VoxelKey& key : *occupied) {
    octree->setNodeValue(ToOctomap(key), octree->getClampingThresMaxLog(), /*lazy_eval=*/true);
  }
  octree->updateInnerOccupancy();
  octree->prune();

  auto plan = SliceFloorPlan(*octree, config.slice_min_height_m, config.slice_max_height_m);
  if (!plan.ok()) return plan.status();
  if (HasFreeCell(*plan)) {
    FillGaps(*plan, static_cast<int>(config.floor_gap_m / config.voxel_size_m));
  } else {
    FillEnclosed(*plan);
  }
  if (!HasFreeCell(*plan)) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "the point cloud shows neither a floor at the height %g m nor a closed outline between %g "
        "m "
        "and %g m, so nothing of it is known to be free",
        config.floor_height_m, config.slice_min_height_m, config.slice_max_height_m));
  }
  return Building{std::move(octree), *std::move(plan)};
}

}  // namespace soundmap::building
