#include "mapping/loop_closing.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"
#include "mapping/point_thinning.h"

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;
using geometry::Pose2;

constexpr int kLevels = 3;
constexpr int kGuesses = 8;

// What a place takes to be believed.
constexpr int kMinInliers = 150;
constexpr double kMinFit = 0.75;
constexpr double kMinOverlap = 0.6;
constexpr double kMinCoverage = 0.5;
// The map's surfaces must be seen in the points so far from the robot.
constexpr double kCoverage_m = 5.0;
// Another place that holds so large a part of the best one's inliers makes both doubtful.
constexpr double kRival = 0.9;
// ... unless so many more of the points find nothing there.
constexpr double kUnexplained = 0.03;
constexpr double kApart_m = 0.3;
constexpr double kApart_rad = geometry::RadFromDeg(4.0);
// A direction for which the surfaces speak less than this part of what they do for the strongest is
// open.
constexpr double kOpen = 0.03;

// The surfaces around a scan, put together of so many scans, to compare more than one view.
constexpr double kAround_m = 3.0;
constexpr int kMaxScansAround = 6;
constexpr double kTarget_m = 8.0;
constexpr int kMaxTargetScans = 40;

// Between the points that are looked for.
constexpr double kSpacing_voxels = 1.5;

constexpr double kMaxSearch_m = 6.0;
constexpr double kMaxSearch_rad = 0.6;
constexpr double kNear_m = 2.0;  // places so near see the same surfaces

bool SamePlace(const Registration& best, const Registration& other) {
  const Isometry3d between = best.map_from_base.inverse() * other.map_from_base;
  const Pose2 apart = geometry::ProjectToFloor(between);
  if (std::abs(apart.yaw_rad) > kApart_rad) return false;
  const Eigen::Vector2d shift(apart.x_m, apart.y_m);
  if (shift.norm() <= kApart_m) return true;
  const Eigen::Matrix2d seen = best.information.topLeftCorner<2, 2>();
  const Eigen::Vector2d along = shift.normalized();
  return along.dot(seen * along) < kOpen * seen.trace();
}

}  // namespace

bool PlaceVerifier::Fits(std::span<const Eigen::Vector3f> point_in_base,
                         const Registration& found) const {
  if (found.inliers < kMinInliers || found.fit() < kMinFit || found.overlap < kMinOverlap) {
    return false;
  }
  const SurfaceMap& map = map_.levels().front();
  SurfaceMap seen(2.0 * map.voxel_size_m());
  std::vector<Eigen::Vector3f> points;
  for (const Eigen::Vector3f& point : point_in_base) {
    points.push_back(found.map_from_base.cast<float>() * point);
  }
  seen.Insert(points);
  const Eigen::Vector3f place = found.map_from_base.translation().cast<float>();
  int around = 0, covered = 0;
  for (const Surfel& surfel : map.surfels()) {
    if (!surfel.has_plane() || (surfel.mean - place).squaredNorm() > kCoverage_m * kCoverage_m) {
      continue;
    }
    ++around;
    covered += seen.Nearest(surfel.mean, 2.0 * map.voxel_size_m()) != nullptr;
  }
  return covered >= kMinCoverage * around;
}

std::vector<Registration> PlaceVerifier::FindAll(std::span<const Eigen::Vector3f> point_in_base,
                                                 const SearchWindow& window) const {
  std::vector<Registration> fitting;
  for (const PoseGuess& guess : search_.Best(point_in_base, window, kGuesses)) {
    if (auto found = FindNear(point_in_base, guess.map_from_base.ToIsometry())) {
      fitting.push_back(*found);
    }
  }
  std::stable_sort(
      fitting.begin(), fitting.end(),
      [](const Registration& a, const Registration& b) { return a.inliers > b.inliers; });
  return fitting;
}

std::optional<Registration> PlaceVerifier::FindNear(std::span<const Eigen::Vector3f> point_in_base,
                                                    const Isometry3d& map_from_base) const {
  const SearchRange range{.start_distance_m = map_.levels().back().voxel_size_m(),
                          .prior_std_m = 0.5,
                          .prior_std_rad = 0.1};
  const Registration found = RegisterCoarseToFine(point_in_base, map_, map_from_base, range);
  if (!Fits(point_in_base, found)) return std::nullopt;
  return found;
}

std::optional<Registration> PlaceVerifier::Find(std::span<const Eigen::Vector3f> point_in_base,
                                                const SearchWindow& window) const {
  const std::vector<Registration> fitting = FindAll(point_in_base, window);
  if (fitting.empty()) return std::nullopt;
  for (const Registration& other : fitting) {
    if (!SamePlace(fitting.front(), other) && other.inliers > kRival * fitting.front().inliers &&
        other.overlap > fitting.front().overlap - kUnexplained) {
      return std::nullopt;
    }
  }
  return fitting.front();
}

bool CloseLoop(KeyScanGraph& graph, int scan, double surface_voxel_size_m, LoopCount& count) {
  const std::vector<ScanUncertainty> uncertainty = graph.UncertaintyFrom(scan);
  const auto reach_m = [&](int other) {
    const ScanUncertainty& between = uncertainty[other];
    // The yaw errs on the way, not all at its beginning: it tells about a third of the way.
    return std::min(
        3.0 * std::hypot(between.std_m(), std::sqrt(between.variance_rad2) * between.way_m / 3.0),
        kMaxSearch_m);
  };
  int nearest = -1;
  double nearest_m = 0.0;
  for (int i = 0; i < static_cast<int>(graph.scans.size()); ++i) {
    if (Trusted(uncertainty[i])) continue;
    const double distance_m = graph.Between(scan, i).translation().norm();
    if (distance_m > kNear_m + reach_m(i) || (nearest >= 0 && distance_m >= nearest_m)) continue;
    nearest = i;
    nearest_m = distance_m;
  }
  if (nearest < 0) return false;
  ++count.tried;

  // The other place's surfaces in the frame of its scan.
  SurfacePyramid target(surface_voxel_size_m, kLevels);
  target.Insert(
      PointsAround(graph, nearest, kTarget_m, kMaxTargetScans, 0.5 * surface_voxel_size_m));
  target.FitPlanes();
  const PlaceVerifier verifier(target);
  const double search_m = 0.3 + (std::isfinite(reach_m(nearest)) ? reach_m(nearest) : kMaxSearch_m);
  const double search_rad =
      std::min(0.05 + 3.0 * std::sqrt(uncertainty[nearest].variance_rad2), kMaxSearch_rad);
  const SearchWindow window{geometry::ProjectToFloor(graph.Between(nearest, scan)), search_m,
                            search_m, search_rad};
  const auto found = verifier.Find(
      PointsAround(graph, scan, kAround_m, kMaxScansAround, kSpacing_voxels * surface_voxel_size_m),
      window);
  if (!found) return false;
  // What is further off is a place that looks alike.
  const Isometry3d off = graph.Between(nearest, scan).inverse() * found->map_from_base;
  if (off.translation().norm() > search_m) return false;

  const Isometry3d here = Eigen::Isometry3d::Identity();
  graph.edges.push_back({nearest, scan, found->map_from_base,
                         EdgeInformation(here, found->information, EdgeKind::kLoop),
                         /*loop=*/true});
  PoseGraphReport report;
  const absl::Status status = graph.Optimize(&report);
  if (!status.ok() || report.weight.back() < PoseGraphConfig{}.min_loop_weight) {
    ++count.refused;
    graph.edges.pop_back();
    graph.Optimize().IgnoreError();  // back to where the others have it
    return false;
  }
  ++count.closed;
  return true;
}

}  // namespace soundmap::mapping
