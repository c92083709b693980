#include "mapping/building_from_scans.h"

#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>

#include "geometry/pose.h"
#include "mapping/point_thinning.h"
#include "mapping/surface_map.h"

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;

constexpr double kPrior_m = 0.03;
constexpr double kPrior_rad = 0.02;
// A building's surfaces weigh as many scans.
constexpr int kBuildingWeight = 50;
// At most so much of a ray is taken to graze its surface.
constexpr double kMaxMargin_m = 1.0;

absl::Status Cancelled() { return absl::CancelledError("the mapping was cancelled"); }

std::vector<Eigen::Vector3f> InMap(const KeyScan& scan, std::span<const Eigen::Vector3f> points) {
  const Eigen::Isometry3f map_from_base = scan.map_from_base.cast<float>();
  std::vector<Eigen::Vector3f> in_map;
  in_map.reserve(points.size());
  for (const Eigen::Vector3f& point : points) in_map.push_back(map_from_base * point);
  return in_map;
}

SurfaceMap MapOf(const std::vector<KeyScan>& scans, std::span<const Eigen::Vector3f> building,
                 double voxel_size_m) {
  SurfaceMap surfaces(voxel_size_m);
  for (int i = 0; i < kBuildingWeight; ++i) surfaces.Insert(building);
  for (const KeyScan& scan : scans) surfaces.Insert(InMap(scan, scan.point_in_base));
  surfaces.FitPlanes();
  return surfaces;
}

}  // namespace

std::vector<Eigen::Vector3f> SurfacePoints(const octomap::OcTree& octree) {
  std::vector<Eigen::Vector3f> all, visible;
  const auto depth = octree.getTreeDepth();
  for (auto leaf = octree.begin_leafs(), end = octree.end_leafs(); leaf != end; ++leaf) {
    if (!octree.isNodeOccupied(*leaf)) continue;
    const int cells = 1 << (depth - leaf.getDepth());
    const octomap::OcTreeKey first = leaf.getIndexKey();
    for (int i = 0; i < cells * cells * cells; ++i) {
      const int offset[3] = {i % cells, i / cells % cells, i / cells / cells};
      const octomap::OcTreeKey key(first[0] + offset[0], first[1] + offset[1],
                                   first[2] + offset[2]);
      const octomap::point3d centre = octree.keyToCoord(key);
      const Eigen::Vector3f point(centre.x(), centre.y(), centre.z());
      all.push_back(point);
      for (int side = 0; side < 6; ++side) {
        octomap::OcTreeKey neighbour = key;
        neighbour[side / 2] += side % 2 == 0 ? 1 : -1;
        const auto* node = octree.search(neighbour);
        if (!node || octree.isNodeOccupied(node)) continue;
        visible.push_back(point);
        break;
      }
    }
  }
  return visible.empty() ? all : visible;
}

SurfacePyramid AllSurfaces(const std::vector<KeyScan>& scans,
                           std::span<const Eigen::Vector3f> building, double voxel_size_m,
                           int levels) {
  SurfacePyramid surfaces(voxel_size_m, levels);
  surfaces.Insert(building);
  for (const KeyScan& scan : scans) {
    surfaces.Insert(InMap(scan, ThinPoints(scan.point_in_base, 0.5 * voxel_size_m)));
  }
  surfaces.FitPlanes();
  return surfaces;
}

absl::Status RelaxScans(std::vector<KeyScan>& scans, std::span<const Eigen::Vector3f> building,
                        double surface_voxel_size_m, int passes, const ProgressFn& progress,
                        double& mean_residual_m) {
  bool held = !building.empty();
  for (const KeyScan& scan : scans) held = held || (scan.fixed && &scan != &scans.front());
  for (int pass = 0; pass < passes; ++pass) {
    const SurfaceMap surfaces = MapOf(scans, building, surface_voxel_size_m);
    std::vector<Isometry3d> aligned;
    double residual_sum_m = 0.0;
    for (const KeyScan& scan : scans) {
      const AlignedPoints points = PointsToAlign(scan.point_in_base, surface_voxel_size_m);
      // Each point weighs once: surfaces that all scans have bent alike must not pull too hard.
      const SearchRange range{.start_distance_m = surface_voxel_size_m,
                              .prior_std_m = kPrior_m,
                              .prior_std_rad = kPrior_rad};
      const Registration registration =
          Register(points.points, surfaces, scan.map_from_base, range);
      aligned.push_back(registration.map_from_base);
      residual_sum_m += registration.mean_residual_m;
      const double done =
          (pass + static_cast<double>(aligned.size()) / static_cast<double>(scans.size())) / passes;
      if (progress && !progress(done)) return Cancelled();
    }
    mean_residual_m = residual_sum_m / static_cast<double>(scans.size());
    // Without anything else that is fixed the whole may have moved a little: back to the first
    // scan.
    Isometry3d anchored_from_aligned = Isometry3d::Identity();
    if (!held) {
      anchored_from_aligned =
          geometry::ProjectToFloor(scans.front().map_from_base * aligned.front().inverse())
              .ToIsometry();
    }
    for (std::size_t i = 0; i < scans.size(); ++i) {
      if (held && scans[i].fixed) continue;
      scans[i].map_from_base = anchored_from_aligned * aligned[i];
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<octomap::OcTree>> CastRays(
    const std::vector<KeyScan>& scans, const octomap::OcTree* extend, double voxel_size_m,
    double surface_voxel_size_m, const OccupancyConfig& config, const ProgressFn& progress) {
  const SurfaceMap surfaces = MapOf(scans, {}, surface_voxel_size_m);
  OccupancyGrid grid(voxel_size_m, config);
  if (extend) {
    if (const absl::Status status = grid.InsertKnown(*extend); !status.ok()) return status;
  }
  std::vector<Ray> rays;
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const KeyScan& scan = scans[i];
    const std::vector<Eigen::Vector3f> ends = InMap(scan, scan.point_in_base);
    const std::vector<Eigen::Vector3f> origins = InMap(scan, scan.lidar_in_base);
    rays.clear();
    for (std::size_t p = 0; p < ends.size(); ++p) {
      Ray ray{origins[scan.part[p]], ends[p], static_cast<float>(voxel_size_m)};
      const Surfel* surfel = surfaces.At(ray.end_in_map);
      if (surfel && surfel->has_plane()) {
        const Eigen::Vector3f direction = (ray.end_in_map - ray.origin_in_map).normalized();
        ray.margin_m = static_cast<float>(
            std::min(voxel_size_m / std::abs(surfel->normal.dot(direction)), kMaxMargin_m));
      }
      rays.push_back(ray);
    }
    if (const absl::Status status = grid.InsertScan(rays); !status.ok()) return status;
    const double done = static_cast<double>(i + 1) / static_cast<double>(scans.size());
    if (progress && !progress(done)) return Cancelled();
  }
  for (const KeyScan& scan : scans) {
    const Eigen::Isometry3f map_from_base = scan.map_from_base.cast<float>();
    rays.clear();
    for (const Eigen::Vector3f& to : scan.seen_through.to_in_base) {
      rays.push_back({map_from_base * scan.seen_through.laser_in_base, map_from_base * to});
    }
    if (const absl::Status status = grid.FillSeenThrough(rays); !status.ok()) return status;
  }
  return grid.ToOctree();
}

}  // namespace soundmap::mapping
