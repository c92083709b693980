#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/directions.h"
#include "ray_casting/kernels.h"

namespace soundmap::ray_casting {

// Candidate directions, made ready once for look-ups in the points of many LIDAR scans: the cells
// in which the nearest point of each can lie.
class LookUpDirections {
 public:
  // A direction that is not finite finds nothing. `max_angle_rad` above 0 and below 60 degrees:
  // epsilon = 1 - cos of it.
  LookUpDirections(geometry::DirectionGrid directions, double max_angle_rad);

  int size() const { return grid_.size(); }
  const geometry::DirectionGrid& grid() const { return grid_; }

 private:
  friend class RangeIndex;

  struct Rows {
    std::vector<std::int32_t> begin;
    std::vector<SphereCells::Row> row;

    RowsOfDirections View() const { return {begin.data(), row.data()}; }
  };

  geometry::DirectionGrid grid_;
  double epsilon_;
  float max_chord_;
  float near_chord_;
  std::vector<float> axis_[3];
  Rows near_;
  Rows far_;
};

// The points of one LIDAR scan by their direction as seen from the array, section V.
// The paper writes v_L(j) = M_j O_a / |M_j O_a|, an arrow from the point to the array, whose
// product with the direction v_a towards the source would be largest on the wrong side; here v_L(j)
// points from the array origin O_a to M_j.
//
// Directions are compared in single precision first; what that cannot decide is decided in double
// precision, so that the answer is that of brute force in double precision.
class RangeIndex {
 public:
  explicit RangeIndex(const Kernels& kernels = BestKernels()) : kernels_(kernels) {}

  // Points that are not finite, or lie at the array, are never found. They must stay until the
  // index is made of others, which takes the memory that it has.
  // `base_from_array`: from the frame of the directions to that of the points.
  void Make(std::span<const Eigen::Vector3f> points, const Eigen::Isometry3d& base_from_array);

  // j_i of each direction: the point with the least 1 - v_L . v_a, of several the lowest index;
  // kNoPoint when that is not below epsilon.
  std::vector<std::int32_t> Nearest(const LookUpDirections& directions) const;

  // The voxel in which the ray of each direction ends, as Rays says. It has the length rho_i and
  // keeps the candidate direction, not the LIDAR point's.
  std::vector<std::uint64_t> EndKeys(const LookUpDirections& directions,
                                     std::span<const std::int32_t> nearest,
                                     const Eigen::Isometry3d& map_from_array, double max_range_m,
                                     double voxel_size_m) const;

 private:
  void SortIntoCells();
  std::int32_t DecideInDouble(const LookUpDirections& directions, int i) const;

  const Kernels& kernels_;
  std::span<const Eigen::Vector3f> points_;
  Eigen::Isometry3d base_from_array_ = Eigen::Isometry3d::Identity();
  std::vector<float> unsorted_[3];   // v_L
  std::vector<std::uint16_t> cell_;  // of each
  // By cell, and padded.
  std::vector<float> unit_[3];
  std::vector<std::int32_t> point_;
  std::vector<std::int32_t> begin_;  // of each cell in them, and the end
};

}  // namespace soundmap::ray_casting
