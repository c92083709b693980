#include "mapping/point_thinning.h"

#include <boost/unordered/unordered_flat_set.hpp>
#include <cmath>
#include <optional>

#include "geometry/voxel_key.h"

namespace soundmap::mapping {
namespace {

// One point in each cube of this size, in surface voxels, is enough to align a scan; and of more
// than this many the surfaces err together, not the points one by one.
constexpr double kAlignedPoints_voxels = 0.75;
constexpr std::size_t kMaxAlignedPoints = 4000;
constexpr double kGoldenRatio = 0.6180339887498949;

}  // namespace

std::vector<std::uint32_t> FirstPointPerCube(std::span<const Eigen::Vector3f> points,
                                             double cube_size_m) {
  boost::unordered_flat_set<geometry::VoxelKey, std::hash<geometry::VoxelKey>> taken;
  taken.reserve(points.size() / 4);
  std::vector<std::uint32_t> first;
  std::optional<geometry::VoxelKey> last_key;  // points of a scan come side by side
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto key = geometry::KeyFromPoint(points[i].cast<double>(), cube_size_m);
    if (!key || key == last_key) continue;
    last_key = key;
    if (taken.insert(*key).second) first.push_back(static_cast<std::uint32_t>(i));
  }
  return first;
}

std::vector<Eigen::Vector3f> ThinPoints(std::span<const Eigen::Vector3f> points,
                                        double cube_size_m) {
  std::vector<Eigen::Vector3f> thinned;
  for (const std::uint32_t i : FirstPointPerCube(points, cube_size_m)) {
    thinned.push_back(points[i]);
  }
  return thinned;
}

AlignedPoints PointsToAlign(std::span<const Eigen::Vector3f> points, double surface_voxel_size_m) {
  AlignedPoints aligned{ThinPoints(points, kAlignedPoints_voxels * surface_voxel_size_m)};
  std::vector<Eigen::Vector3f>& chosen = aligned.points;
  const std::size_t all = chosen.size();
  if (all <= kMaxAlignedPoints) return aligned;
  // Steps of the golden ratio: no part of the scan's own order, as of its rings, is preferred.
  std::size_t kept = 0;
  for (std::size_t i = 0; i < all; ++i) {
    const double place = static_cast<double>(i) * kGoldenRatio;
    if ((place - std::floor(place)) * static_cast<double>(all) >= kMaxAlignedPoints) continue;
    chosen[kept++] = chosen[i];
  }
  chosen.resize(kept);
  aligned.stands_for = static_cast<double>(all) / static_cast<double>(chosen.size());
  return aligned;
}

}  // namespace soundmap::mapping
