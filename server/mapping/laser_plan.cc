#include "mapping/laser_plan.h"

#include <octomap/OcTree.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "building/building.h"
#include "mapping/laser_lines.h"
#include "mapping/laser_relaxation.h"
#include "mapping/occupancy_grid.h"
#include "mapping/planar_poses.h"

namespace soundmap::mapping {
namespace {

// At most so much of a ray is taken to graze its wall.
constexpr float kMaxMargin_m = 1.0f;

// Of one layer, moved so that its cells are an octree's voxels.
octomap::OcTree AsOctree(const building::FloorPlan& floor_plan,
                         const Eigen::Vector2d& map_from_grid_m) {
  octomap::OcTree octree(floor_plan.cell_size_m());
  for (int row = 0; row < floor_plan.height(); ++row) {
    for (int column = 0; column < floor_plan.width(); ++column) {
      const building::Cell cell = floor_plan.at(column, row);
      if (cell == building::Cell::kUnknown) continue;
      const Eigen::Vector2d centre =
          floor_plan.origin_in_map_m() - map_from_grid_m +
          floor_plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
      octree.setNodeValue(centre.x(), centre.y(), 0.5 * floor_plan.cell_size_m(),
                          cell == building::Cell::kOccupied ? octree.getClampingThresMaxLog()
                                                            : octree.getClampingThresMinLog(),
                          /*lazy_eval=*/true);
    }
  }
  octree.updateInnerOccupancy();
  return octree;
}

}  // namespace

std::vector<Eigen::Vector2f> WallPoints(const building::FloorPlan& floor_plan) {
  std::vector<Eigen::Vector2f> all, faces;
  for (int row = 0; row < floor_plan.height(); ++row) {
    for (int column = 0; column < floor_plan.width(); ++column) {
      if (floor_plan.at(column, row) != building::Cell::kOccupied) continue;
      const Eigen::Vector2d centre =
          floor_plan.origin_in_map_m() +
          floor_plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
      all.push_back(centre.cast<float>());
      for (const auto& [x, y] :
           {std::pair(1, 0), std::pair(-1, 0), std::pair(0, 1), std::pair(0, -1)}) {
        if (!floor_plan.Contains(column + x, row + y) ||
            floor_plan.at(column + x, row + y) != building::Cell::kFree) {
          continue;
        }
        faces.push_back(all.back());
        break;
      }
    }
  }
  return faces.empty() ? all : faces;
}

absl::StatusOr<building::FloorPlan> DrawFloorPlan(const FloorPlanMapperConfig& config,
                                                  const std::vector<LaserKeyScan>& key_scans,
                                                  const building::FloorPlan* extend,
                                                  const std::function<bool(double)>& progress) {
  LineMap lines(config.wall_piece_m);
  for (const LaserKeyScan& key_scan : key_scans) lines.Insert(InMap(key_scan));
  lines.FitLines();

  // One layer of voxels, whose grid lies as the one that is extended.
  const double cell_size_m = extend ? extend->cell_size_m() : config.cell_size_m;
  Eigen::Vector2d map_from_grid_m = Eigen::Vector2d::Zero();
  if (extend) {
    const Eigen::Vector2d cells = extend->origin_in_map_m() / cell_size_m;
    map_from_grid_m = cell_size_m * (cells - cells.array().round().matrix());
  }
  const Eigen::Vector2f shift = map_from_grid_m.cast<float>();
  const float z_m = 0.5f * static_cast<float>(cell_size_m);
  const auto in_grid = [&](const Eigen::Vector2f& p) {
    return Eigen::Vector3f(p.x() - shift.x(), p.y() - shift.y(), z_m);
  };
  OccupancyGrid grid(cell_size_m, config.occupancy);
  if (extend) {
    const absl::Status known = grid.InsertKnown(AsOctree(*extend, map_from_grid_m));
    if (!known.ok()) return known;
  }
  std::vector<Ray> rays;
  for (std::size_t k = 0; k < key_scans.size(); ++k) {
    const LaserKeyScan& key_scan = key_scans[k];
    const Eigen::Isometry2f map_from_base = InPlane(key_scan.map_from_base);
    rays.clear();
    for (std::size_t i = 0; i < key_scan.points.point_in_base.size(); ++i) {
      const Eigen::Vector2f origin = map_from_base * key_scan.points.LaserInBase(i);
      const Eigen::Vector2f end = map_from_base * key_scan.points.point_in_base[i];
      Ray ray{in_grid(origin), in_grid(end), static_cast<float>(cell_size_m)};
      const LinePiece* piece = lines.At(end);
      if (piece && piece->has_line()) {
        const float sine = std::abs(piece->normal.dot((end - origin).normalized()));
        ray.margin_m = std::min(static_cast<float>(cell_size_m) / sine, kMaxMargin_m);
      }
      rays.push_back(ray);
    }
    if (const absl::Status status = grid.InsertScan(rays); !status.ok()) return status;
    if (progress && !progress(static_cast<double>(k + 1) / static_cast<double>(key_scans.size()))) {
      return absl::CancelledError("the mapping was cancelled");
    }
  }
  auto drawn = building::SliceFloorPlan(*grid.ToOctree(), 0.25 * cell_size_m, 0.75 * cell_size_m);
  if (!drawn.ok() || !extend) return drawn;
  building::FloorPlan floor_plan(drawn->width(), drawn->height(), cell_size_m,
                                 drawn->origin_in_map_m() + map_from_grid_m);
  for (int row = 0; row < drawn->height(); ++row) {
    for (int column = 0; column < drawn->width(); ++column) {
      floor_plan.at(column, row) = drawn->at(column, row);
    }
  }
  return floor_plan;
}

}  // namespace soundmap::mapping
