#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "ray_casting/sphere_cells.h"

namespace soundmap::ray_casting {

// Sorted points are followed by this many that are far from all directions.
inline constexpr std::size_t kPadding = 8;

// Unit vectors from an origin to points, and their cells.
struct UnitVectors {
  std::span<const Eigen::Vector3f> points;
  // Their difference is as exact in two steps as in double precision.
  float origin_high[3];
  float origin_low[3];
  Eigen::Matrix3f turn;  // of the unit vectors
  float* unit[3];
  std::uint16_t* cell;  // SphereCells::size(): at the origin, or not finite
};

// Points in the order of their cells.
struct SortedPoints {
  const float* unit[3];       // padded
  const std::int32_t* point;  // index of each
  const std::int32_t* begin;  // of each cell in them
  // Of chords between unit vectors, squared: what is below is surely within the angle, what is
  // above surely beyond it.
  float within_chord2;
  float beyond_chord2;
};

// Rows of cells of direction i: row[begin[i]] .. row[begin[i + 1] - 1].
struct RowsOfDirections {
  const std::int32_t* begin;
  const SphereCells::Row* row;
};

struct Directions {
  const float* axis[3];
  int count;
  RowsOfDirections near;
  float near_chord2;     // what is below lies within the near rows, and within the angle
  RowsOfDirections far;  // hold all points within the angle
};

inline constexpr std::int32_t kNoPoint = -1;
inline constexpr std::int32_t kUndecided = -2;  // single precision cannot tell

// The inner loops, for one kind of processor. What they find does not depend on it: where rounding
// could make a difference they say so.
struct Kernels {
  const char* name;
  void (*make_unit_vectors)(const UnitVectors&);
  // The nearest point of each direction.
  void (*find_nearest)(const SortedPoints&, const Directions&, std::int32_t* nearest);
};

// Those that this processor can run, the fastest last.
const std::vector<Kernels>& AllKernels();
inline const Kernels& BestKernels() { return AllKernels().back(); }

// The voxels in which rays end.
struct Rays {
  const Eigen::Vector3f* points;
  const Eigen::Vector3d* direction_in_array;
  const std::int32_t* nearest;  // point of each direction, or kNoPoint
  int count;
  Eigen::Vector3d base_from_array_m;  // where the array is among the points
  Eigen::Isometry3d map_from_array;
  double max_range_m;
  double voxel_size_m;
  std::uint64_t* key;  // of each ray, x << 32 | y << 16 | z; kNoKey: beyond the range or the octree
};
inline constexpr std::uint64_t kNoKey = ~std::uint64_t{0};
void FindEndKeys(const Rays& rays);

// Two chords whose squares differ by no more may be in another order in double precision.
inline constexpr float kUndecidedChord2 = 1e-11f;
inline float UndecidedChord2(float chord) {
  return 2.0f * SphereCells::kRounding * chord + kUndecidedChord2;
}

}  // namespace soundmap::ray_casting
