#pragma once

#include <Eigen/Core>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "geometry/voxel_key.h"

namespace soundmap::mapping {

// A place on a surface, in `map`: the mean of the points in one voxel.
struct Surfel {
  Eigen::Vector3f mean = Eigen::Vector3f::Zero();
  std::uint32_t points = 0;
  // Sum of the squared deviations from the mean.
  Eigen::Matrix3f scatter = Eigen::Matrix3f::Zero();
  // The plane through the points around, if they lie on one; the normal's sign is arbitrary, zero
  // means no plane.
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();
  float offset_m = 0.0f;  // normal . x = offset on the plane

  bool has_plane() const { return normal.squaredNorm() > 0.0f; }
};

// The surfaces seen so far in a hash map of voxels. Memory grows with the surfaces, not with the
// points.
class SurfaceMap {
 public:
  explicit SurfaceMap(double voxel_size_m) : voxel_size_m_(voxel_size_m) {}

  // Points outside the range of voxel keys or not finite are left out. Planes are as before until
  // FitPlanes().
  void Insert(std::span<const Eigen::Vector3f> point_in_map);

  // Fits planes anew where points were added since the last time.
  void FitPlanes();

  // The surfel whose mean is nearest, at most `max_distance_m` away; of equally near ones the first
  // in key order. Null if there is none.
  const Surfel* Nearest(const Eigen::Vector3f& point_in_map, double max_distance_m) const;

  // The surfel of the voxel that the point lies in. Null if there is none.
  const Surfel* At(const Eigen::Vector3f& point_in_map) const;

  double voxel_size_m() const { return voxel_size_m_; }
  std::size_t size() const { return surfels_.size(); }
  const std::vector<Surfel>& surfels() const { return surfels_; }

 private:
  using Index =
      boost::unordered_flat_map<geometry::VoxelKey, std::uint32_t, std::hash<geometry::VoxelKey>>;

  void FitPlane(const geometry::VoxelKey& key, Surfel& surfel) const;

  double voxel_size_m_;
  Index index_;
  std::vector<Surfel> surfels_;
  std::vector<geometry::VoxelKey> keys_;  // of the surfels
  std::vector<std::uint32_t> changed_;    // surfels with points since the last FitPlanes()
  std::vector<bool> is_changed_;
};

}  // namespace soundmap::mapping
