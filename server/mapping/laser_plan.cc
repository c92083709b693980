#include "mapping/laser_plan.h"

#include <octomap/OcTree.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "building/building.h"
#include "mapping/laser_lines.h"
#include "mapping/occupancy_grid.h"

namespace soundmap::mapping {
namespace {

// At most so much of a ray is taken to graze its wall.
constexpr float kMaxMargin_m = 1.0f;

Eigen::Isometry2f InPlane(const geometry::Pose2& pose) {
  return Eigen::Translation2f(static_cast<float>(pose.x_m), static_cast<float>(pose.y_m)) *
         Eigen::Rotation2Df(static_cast<float>(pose.yaw_rad));
}

}  // namespace

absl::StatusOr<building::FloorPlan> DrawFloorPlan(const FloorPlanMapperConfig& config,
                                                  const std::vector<LaserKeyScan>& key_scans,
                                                  const std::function<bool(double)>& progress) {
  LineMap lines(config.wall_piece_m);
  std::vector<Eigen::Vector2f> in_map;
  for (const LaserKeyScan& key_scan : key_scans) {
    const Eigen::Isometry2f map_from_base = InPlane(key_scan.map_from_base);
    in_map.clear();
    for (const Eigen::Vector2f& point : key_scan.points.point_in_base) {
      in_map.push_back(map_from_base * point);
    }
    lines.Insert(in_map);
  }
  lines.FitLines();

  // One layer of voxels.
  const float z_m = 0.5f * static_cast<float>(config.cell_size_m);
  const auto at_height = [z_m](const Eigen::Vector2f& p) {
    return Eigen::Vector3f(p.x(), p.y(), z_m);
  };
  OccupancyGrid grid(config.cell_size_m, config.occupancy);
  std::vector<Ray> rays;
  for (std::size_t k = 0; k < key_scans.size(); ++k) {
    const LaserKeyScan& key_scan = key_scans[k];
    const Eigen::Isometry2f map_from_base = InPlane(key_scan.map_from_base);
    rays.clear();
    for (std::size_t i = 0; i < key_scan.points.point_in_base.size(); ++i) {
      const Eigen::Vector2f origin = map_from_base * key_scan.points.LaserInBase(i);
      const Eigen::Vector2f end = map_from_base * key_scan.points.point_in_base[i];
      Ray ray{at_height(origin), at_height(end), static_cast<float>(config.cell_size_m)};
      const LinePiece* piece = lines.At(end);
      if (piece && piece->has_line()) {
        const float sine = std::abs(piece->normal.dot((end - origin).normalized()));
        ray.margin_m = std::min(static_cast<float>(config.cell_size_m) / sine, kMaxMargin_m);
      }
      rays.push_back(ray);
    }
    if (const absl::Status status = grid.InsertScan(rays); !status.ok()) return status;
    if (progress && !progress(static_cast<double>(k + 1) / static_cast<double>(key_scans.size()))) {
      return absl::CancelledError("the mapping was cancelled");
    }
  }
  return building::SliceFloorPlan(*grid.ToOctree(), 0.25 * config.cell_size_m,
                                  0.75 * config.cell_size_m);
}

}  // namespace soundmap::mapping
