#include "mapping/laser_relaxation.h"

#include <Eigen/Geometry>

#include "mapping/laser_lines.h"
#include "mapping/laser_matching.h"
#include "mapping/planar_poses.h"
#include "mapping/surveyed_poses.h"

namespace soundmap::mapping {
namespace {

using frames::TimeNs;
using geometry::Pose2;

// The walls of a map that exists weigh as many scans.
constexpr int kWallWeight = 50;

}  // namespace

std::vector<Eigen::Vector2f> InMap(const LaserKeyScan& key_scan) {
  const Eigen::Isometry2f map_from_base = InPlane(key_scan.map_from_base);
  std::vector<Eigen::Vector2f> in_map;
  in_map.reserve(key_scan.points.point_in_base.size());
  for (const Eigen::Vector2f& point : key_scan.points.point_in_base) {
    in_map.push_back(map_from_base * point);
  }
  return in_map;
}

absl::Status RelaxLaserScans(const FloorPlanMapperConfig& config,
                             std::span<const Eigen::Vector2f> walls,
                             const std::function<bool(double)>& progress,
                             std::vector<LaserKeyScan>& key_scans, double& mean_residual_m) {
  for (int pass = 0; pass < config.relaxation_passes; ++pass) {
    LineMap lines(config.wall_piece_m);
    for (int i = 0; i < kWallWeight; ++i) lines.Insert(walls);
    for (const LaserKeyScan& key_scan : key_scans) lines.Insert(InMap(key_scan));
    lines.FitLines();
    std::vector<Pose2> aligned;
    double residual_sum_m = 0.0;
    for (const LaserKeyScan& key_scan : key_scans) {
      const LaserMatch match = MatchToLines(key_scan.point_to_match, lines, key_scan.map_from_base,
                                            {.start_distance_m = config.wall_piece_m,
                                             .prior_std_m = StepStd_m(0.0),
                                             .prior_std_rad = StepStd_rad(0.0)});
      aligned.push_back(match.map_from_base);
      residual_sum_m += match.mean_residual_m;
      const double done = (pass + static_cast<double>(aligned.size()) / key_scans.size()) /
                          config.relaxation_passes;
      if (progress && !progress(done)) return absl::CancelledError("the mapping was cancelled");
    }
    mean_residual_m = residual_sum_m / static_cast<double>(key_scans.size());
    const Pose2 anchored_from_aligned =
        walls.empty() ? key_scans.front().map_from_base * aligned.front().Inverse() : Pose2{};
    for (std::size_t i = 0; i < key_scans.size(); ++i) {
      key_scans[i].map_from_base = anchored_from_aligned * aligned[i];
    }
  }
  return absl::OkStatus();
}

void PlacePath(const std::vector<LaserKeyScan>& key_scans, std::vector<LaserPathEntry>& path) {
  std::vector<Pose2> before;
  for (const LaserKeyScan& key_scan : key_scans) {
    before.push_back(path[key_scan.path_index].map_from_base);
  }
  for (LaserPathEntry& entry : path) {
    const std::size_t begin = entry.key_scan.value_or(0);
    const LaserKeyScan& first = key_scans[begin];
    if (!entry.key_scan || begin + 1 == key_scans.size()) {
      entry.map_from_base = first.map_from_base * before[begin].Inverse() * entry.map_from_base;
      continue;
    }
    const LaserKeyScan& second = key_scans[begin + 1];
    const TimeNs begin_ns = path[first.path_index].stamp_ns;
    const TimeNs end_ns = path[second.path_index].stamp_ns;
    entry.map_from_base = Between(
        first.map_from_base, before[begin], second.map_from_base, before[begin + 1],
        entry.map_from_base,
        static_cast<double>(entry.stamp_ns - begin_ns) / static_cast<double>(end_ns - begin_ns));
  }
}

}  // namespace soundmap::mapping
