#include "mapping/surface_map.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <optional>

namespace soundmap::mapping {
namespace {

// A plane's points spread in two directions and hardly in the third (variances).
constexpr int kMinMeans = 5;
constexpr float kMaxThicknessRatio = 0.1f;
constexpr float kMinWidthRatio = 0.1f;
constexpr float kMaxThickness_voxels = 0.3f;

// A neighbourhood of one voxel on each side first; wider where the points are too thin for a plane.
constexpr int kNeighbourhoods[] = {1, 2, 4};

// A voxel is skipped only if it is clearly too far, rounding aside.
constexpr float kGapMargin = 0.999f;

std::optional<geometry::VoxelKey> Offset(const geometry::VoxelKey& key, int x, int y, int z) {
  const int shifted[3] = {key.x + x, key.y + y, key.z + z};
  for (const int value : shifted) {
    if (value < 0 || value > 65535) return std::nullopt;
  }
  return geometry::VoxelKey{static_cast<std::uint16_t>(shifted[0]),
                            static_cast<std::uint16_t>(shifted[1]),
                            static_cast<std::uint16_t>(shifted[2])};
}

}  // namespace

void SurfaceMap::Insert(std::span<const Eigen::Vector3f> point_in_map) {
  std::optional<geometry::VoxelKey> last_key;  // points of a scan come side by side
  std::uint32_t i = 0;
  for (const Eigen::Vector3f& point : point_in_map) {
    const auto key = geometry::KeyFromPoint(point.cast<double>(), voxel_size_m_);
    if (!key) continue;
    if (key != last_key) {
      const auto [entry, is_new] =
          index_.try_emplace(*key, static_cast<std::uint32_t>(surfels_.size()));
      if (is_new) {
        surfels_.emplace_back();
        keys_.push_back(*key);
        is_changed_.push_back(false);
      }
      last_key = key;
      i = entry->second;
    }
    Surfel& surfel = surfels_[i];
    ++surfel.points;
    const Eigen::Vector3f from_old_mean = point - surfel.mean;
    surfel.mean += from_old_mean / static_cast<float>(surfel.points);
    surfel.scatter += from_old_mean * (point - surfel.mean).transpose();
    if (!is_changed_[i]) {
      is_changed_[i] = true;
      changed_.push_back(i);
    }
  }
}

void SurfaceMap::FitPlanes() {
  for (const std::uint32_t i : changed_) {
    FitPlane(keys_[i], surfels_[i]);
    is_changed_[i] = false;
  }
  changed_.clear();
}

void SurfaceMap::FitPlane(const geometry::VoxelKey& key, Surfel& surfel) const {
  surfel.normal.setZero();
  for (const int reach : kNeighbourhoods) {
    // The covariance of all points around, put together from those of the voxels.
    int means = 0;
    float weight_sum = 0.0f;
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    Eigen::Matrix3f products = Eigen::Matrix3f::Zero();
    for (int x = -reach; x <= reach; ++x) {
      for (int y = -reach; y <= reach; ++y) {
        for (int z = -reach; z <= reach; ++z) {
          const auto neighbour_key = Offset(key, x, y, z);
          if (!neighbour_key) continue;
          const auto neighbour = index_.find(*neighbour_key);
          if (neighbour == index_.end()) continue;
          const Surfel& other = surfels_[neighbour->second];
          const Eigen::Vector3f arm = other.mean - surfel.mean;
          const auto weight = static_cast<float>(other.points);
          ++means;
          weight_sum += weight;
          sum += weight * arm;
          products += other.scatter + weight * arm * arm.transpose();
        }
      }
    }
    if (means < kMinMeans) continue;
    const Eigen::Vector3f centre = sum / weight_sum;
    const Eigen::Matrix3f covariance = products / weight_sum - centre * centre.transpose();
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f> solver;
    solver.computeDirect(covariance);
    const Eigen::Vector3f variance = solver.eigenvalues();
    if (variance[1] < kMinWidthRatio * variance[2]) continue;  // a line: look further around
    const float thickness_m = std::sqrt(std::max(variance[0], 0.0f));
    if (variance[0] > kMaxThicknessRatio * variance[1] ||
        thickness_m > kMaxThickness_voxels * static_cast<float>(voxel_size_m_)) {
      return;
    }
    surfel.normal = solver.eigenvectors().col(0);
    surfel.offset_m = surfel.normal.dot(surfel.mean + centre);
    return;
  }
}

const Surfel* SurfaceMap::At(const Eigen::Vector3f& point_in_map) const {
  const auto key = geometry::KeyFromPoint(point_in_map.cast<double>(), voxel_size_m_);
  if (!key) return nullptr;
  const auto entry = index_.find(*key);
  return entry == index_.end() ? nullptr : &surfels_[entry->second];
}

const Surfel* SurfaceMap::Nearest(const Eigen::Vector3f& point_in_map,
                                  double max_distance_m) const {
  const auto key = geometry::KeyFromPoint(point_in_map.cast<double>(), voxel_size_m_);
  if (!key) return nullptr;
  const int reach = static_cast<int>(std::ceil(max_distance_m / voxel_size_m_));
  const Eigen::Vector3f voxel_centre = geometry::PointFromKey(*key, voxel_size_m_).cast<float>();
  const auto size_m = static_cast<float>(voxel_size_m_);
  // Squared distance along an axis from the point to the voxels that lie `offset` voxels further.
  const auto squared_gap_m2 = [&](int axis, int offset) {
    const float from_centre_m = point_in_map[axis] - voxel_centre[axis];
    const float gap_m = offset > 0   ? (static_cast<float>(offset) - 0.5f) * size_m - from_centre_m
                        : offset < 0 ? (static_cast<float>(-offset) - 0.5f) * size_m + from_centre_m
                                     : 0.0f;
    return kGapMargin * gap_m * gap_m;
  };
  const Surfel* nearest = nullptr;
  auto nearest_squared_m2 = static_cast<float>(max_distance_m * max_distance_m);
  geometry::VoxelKey nearest_key;
  for (int ring = 0; ring <= reach; ++ring) {
    // What lies in this ring or further out is at least this far away.
    const float ring_distance_m = static_cast<float>(ring - 1) * size_m;
    if (ring > 1 && ring_distance_m * ring_distance_m > nearest_squared_m2) break;
    for (int x = -ring; x <= ring; ++x) {
      const float gap_x_m2 = squared_gap_m2(0, x);
      if (gap_x_m2 > nearest_squared_m2) continue;
      for (int y = -ring; y <= ring; ++y) {
        const float gap_xy_m2 = gap_x_m2 + squared_gap_m2(1, y);
        if (gap_xy_m2 > nearest_squared_m2) continue;
        const bool on_side = std::abs(x) == ring || std::abs(y) == ring;
        for (int z = -ring; z <= ring; z += on_side || ring == 0 ? 1 : 2 * ring) {
          if (gap_xy_m2 + squared_gap_m2(2, z) > nearest_squared_m2) continue;
          const auto other = Offset(*key, x, y, z);
          if (!other) continue;
          const auto entry = index_.find(*other);
          if (entry == index_.end()) continue;
          const Surfel& surfel = surfels_[entry->second];
          const float squared_m2 = (surfel.mean - point_in_map).squaredNorm();
          if (squared_m2 < nearest_squared_m2 ||
              (squared_m2 == nearest_squared_m2 && (!nearest || *other < nearest_key))) {
            nearest = &surfel;
            nearest_squared_m2 = squared_m2;
            nearest_key = *other;
          }
        }
      }
    }
  }
  return nearest;
}

}  // namespace soundmap::mapping
