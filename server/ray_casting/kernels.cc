#include "ray_casting/kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "geometry/voxel_key.h"

namespace soundmap::ray_casting {
namespace {

// Whether its square is exact enough as a float.
SOUNDMAP_INLINE bool IsOrdinary(float square_m2) {
  return (square_m2 > 1e-24f) & (square_m2 < 1e24f);
}

void MakeUnitVectorInDouble(const UnitVectors& in, std::size_t j) {
  Eigen::Vector3d away;
  for (int axis = 0; axis < 3; ++axis) {
    away[axis] = double{in.points[j][axis]} - in.origin_high[axis] - in.origin_low[axis];
  }
  const Eigen::Vector3d unit = in.turn.cast<double>() * (away / away.norm());
  for (int axis = 0; axis < 3; ++axis) in.unit[axis][j] = static_cast<float>(unit[axis]);
}

// Loops of which the compiler makes vectors, over blocks that stay in the nearest cache.
SOUNDMAP_INLINE void MakeUnitVectors(const UnitVectors& in) {
  constexpr std::size_t kBlock = 256;
  const SphereCells& cells = SphereCells::Get();
  const Eigen::Matrix3f turn = in.turn;
  float azimuth_ratio[kBlock];
  std::int32_t band[kBlock];
  for (std::size_t first = 0; first < in.points.size(); first += kBlock) {
    const int count = static_cast<int>(std::min(kBlock, in.points.size() - first));
    const float* const point = in.points[first].data();
    float* const __restrict x = in.unit[0] + first;
    float* const __restrict y = in.unit[1] + first;
    float* const __restrict z = in.unit[2] + first;
    int ordinary = 1;
    for (int k = 0; k < count; ++k) {
      const float a = (point[3 * k] - in.origin_high[0]) - in.origin_low[0];
      const float b = (point[3 * k + 1] - in.origin_high[1]) - in.origin_low[1];
      const float c = (point[3 * k + 2] - in.origin_high[2]) - in.origin_low[2];
      const float square = a * a + b * b + c * c;
      const float inverse = 1.0f / std::sqrt(square);
      x[k] = (a * turn(0, 0) + b * turn(0, 1) + c * turn(0, 2)) * inverse;
      y[k] = (a * turn(1, 0) + b * turn(1, 1) + c * turn(1, 2)) * inverse;
      z[k] = (a * turn(2, 0) + b * turn(2, 1) + c * turn(2, 2)) * inverse;
      ordinary &= IsOrdinary(square) ? 1 : 0;
    }
    if (ordinary == 0) {
      for (int k = 0; k < count; ++k) {
        const Eigen::Vector3f away((point[3 * k] - in.origin_high[0]) - in.origin_low[0],
                                   (point[3 * k + 1] - in.origin_high[1]) - in.origin_low[1],
                                   (point[3 * k + 2] - in.origin_high[2]) - in.origin_low[2]);
        if (!IsOrdinary(away.squaredNorm())) MakeUnitVectorInDouble(in, first + k);
      }
    }
    for (int k = 0; k < count; ++k) {
      const float across = std::sqrt(x[k] * x[k] + y[k] * y[k]);
      band[k] = static_cast<std::int32_t>(
          SphereCells::BandRatio(SphereCells::ElevationRatio(z[k], across)));
      azimuth_ratio[k] = SphereCells::AzimuthRatio(x[k], y[k]);
    }
    for (int k = 0; k < count; ++k) {
      // Not a number: at the origin, or not finite.
      in.cell[first + k] = static_cast<std::uint16_t>(
          x[k] == x[k] ? cells.CellOf(band[k], azimuth_ratio[k]) : cells.size());
    }
  }
}

// The least chord between points and a direction, which point it is, and the least of the other
// points; squared.
struct Least {
  float chord2;
  std::int32_t at;
  float next_chord2;
};

// Whether the other points are farther in double precision as well: the squares of the chords
// differ by more than UndecidedChord2().
SOUNDMAP_INLINE bool IsDecided(const Least& least) {
  constexpr float kPerChord = 2.0f * SphereCells::kRounding;
  const float more = least.next_chord2 - least.chord2 - kUndecidedChord2;
  return more > 0.0f && more * more > kPerChord * kPerChord * least.chord2;
}

template <int lanes>
struct Vector {
  typedef float Float __attribute__((vector_size(lanes * 4)));
  typedef std::int32_t Int __attribute__((vector_size(lanes * 4)));
};

template <int lanes>
class LeastOf {
  using Float = typename Vector<lanes>::Float;
  using Int = typename Vector<lanes>::Int;

 public:
  SOUNDMAP_INLINE LeastOf(const SortedPoints& points, const Directions& directions, int i)
      : points_(points),
        x_(directions.axis[0][i]),
        y_(directions.axis[1][i]),
        z_(directions.axis[2][i]) {
    for (int lane = 0; lane < lanes; ++lane) lane_[lane] = lane;
  }

  // Points at .. at + lanes - 1.
  SOUNDMAP_INLINE void Look(std::int32_t at) {
    const Float x = Load(0, at) - x_;
    const Float y = Load(1, at) - y_;
    const Float z = Load(2, at) - z_;
    const Float chord2 = x * x + y * y + z * z;
    const Int nearer = chord2 < least_;
    const Float loser = nearer ? least_ : chord2;
    next_ = loser < next_ ? loser : next_;
    least_ = nearer ? chord2 : least_;
    at_ = nearer ? lane_ + at : at_;
  }

  SOUNDMAP_INLINE Least OfAllLanes() const {
    // Positive floats are in order as integers as well; the lane takes the place of the last bits,
    // which are below what is undecided.
    const Int with_lane = (__builtin_bit_cast(Int, least_) & -lanes) | lane_;
    const Int nearest = Spread(with_lane);
    const Int others = Spread(with_lane == nearest ? __builtin_bit_cast(Int, next_) : with_lane);
    std::int32_t at[lanes];
    std::memcpy(at, &at_, sizeof(at));
    return {std::bit_cast<float>(nearest[0]), at[nearest[0] & (lanes - 1)],
            std::bit_cast<float>(others[0])};
  }

 private:
  SOUNDMAP_INLINE Float Load(int axis, std::int32_t at) const {
    Float value;
    std::memcpy(&value, points_.unit[axis] + at, sizeof(value));
    return value;
  }

  // Every lane becomes the least of all.
  static SOUNDMAP_INLINE Int Spread(Int v) {
    Int other;
    if constexpr (lanes == 8) {
      other = __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3);
      v = other < v ? other : v;
      other = __builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5);
      v = other < v ? other : v;
      other = __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6);
    } else {
      other = __builtin_shufflevector(v, v, 2, 3, 0, 1);
      v = other < v ? other : v;
      other = __builtin_shufflevector(v, v, 1, 0, 3, 2);
    }
    return other < v ? other : v;
  }

  const SortedPoints points_;
  float x_, y_, z_;
  Int lane_ = {};
  Float least_ = Float{} + 16.0f;
  Float next_ = Float{} + 16.0f;
  Int at_ = Int{} - 1;
};

template <int lanes>
SOUNDMAP_INLINE Least LeastInRows(const SortedPoints& points, const Directions& in, int i,
                                  const RowsOfDirections& rows) {
  LeastOf<lanes> least(points, in, i);
  for (std::int32_t r = rows.begin[i]; r < rows.begin[i + 1]; ++r) {
    const std::int32_t end = points.begin[rows.row[r].end];
    // Lanes past the end of a row are points of cells nearby, which count as well.
    for (std::int32_t at = points.begin[rows.row[r].begin]; at < end; at += lanes) least.Look(at);
  }
  return least.OfAllLanes();
}

template <int lanes>
SOUNDMAP_INLINE void FindNearest(const SortedPoints& points, const Directions& in,
                                 std::int32_t* nearest) {
  for (int i = 0; i < in.count; ++i) {
    Least least = LeastInRows<lanes>(points, in, i, in.near);
    bool within = least.chord2 < in.near_chord2;
    if (!within) {
      least = LeastInRows<lanes>(points, in, i, in.far);
      if (least.chord2 > points.beyond_chord2) {
        nearest[i] = kNoPoint;
        continue;
      }
      within = least.chord2 < points.within_chord2;
    }
    nearest[i] = within && IsDecided(least) ? points.point[least.at] : kUndecided;
  }
}

void PlainMakeUnitVectors(const UnitVectors& in) { MakeUnitVectors(in); }
void PlainFindNearest(const SortedPoints& points, const Directions& in, std::int32_t* nearest) {
  FindNearest<4>(points, in, nearest);
}

#if defined(__x86_64__)
__attribute__((target("avx2"))) void Avx2MakeUnitVectors(const UnitVectors& in) {
  MakeUnitVectors(in);
}
__attribute__((target("avx2"))) void Avx2FindNearest(const SortedPoints& points,
                                                     const Directions& in, std::int32_t* nearest) {
  FindNearest<8>(points, in, nearest);
}
#endif

// std::floor() for what fits 32 bits, in vectors on every processor.
SOUNDMAP_INLINE double Floor(double value) {
  const double towards_zero = static_cast<std::int32_t>(value);
  return towards_zero - (value < towards_zero ? 1.0 : 0.0);
}

}  // namespace

// In the order of operations of `map_from_array * (range_m * direction)` and KeyFromPoint(), in
// loops of which the compiler makes vectors.
void FindEndKeys(const Rays& in) {
  constexpr int kBlock = 256;
  constexpr double kEdge = geometry::VoxelKey::kCentre;
  const Eigen::Matrix<double, 3, 4> m = in.map_from_array.matrix().topRows<3>();
  const double max_range_m = in.max_range_m;
  const double voxel_size_m = in.voxel_size_m;
  double x[kBlock];
  double y[kBlock];
  double z[kBlock];
  double key[kBlock];  // exact: 48 bits
  for (int first = 0; first < in.count; first += kBlock) {
    const int count = std::min(kBlock, in.count - first);
    for (int k = 0; k < count; ++k) {
      const std::int32_t nearest = in.nearest[first + k];
      const Eigen::Vector3f& point = in.points[std::max(nearest, 0)];
      x[k] = nearest >= 0 ? double{point.x()} - in.base_from_array_m.x()
                          : std::numeric_limits<double>::infinity();
      y[k] = double{point.y()} - in.base_from_array_m.y();
      z[k] = double{point.z()} - in.base_from_array_m.z();
    }
    const double* const direction = in.direction_in_array[first].data();
    for (int k = 0; k < count; ++k) {
      const double range_m = std::sqrt(x[k] * x[k] + (y[k] * y[k] + z[k] * z[k]));
      const double a = range_m * direction[3 * k];
      const double b = range_m * direction[3 * k + 1];
      const double c = range_m * direction[3 * k + 2];
      const double u = (m(0, 0) * a + m(0, 1) * b + m(0, 2) * c + m(0, 3)) / voxel_size_m;
      const double v = (m(1, 0) * a + m(1, 1) * b + m(1, 2) * c + m(1, 3)) / voxel_size_m;
      const double w = (m(2, 0) * a + m(2, 1) * b + m(2, 2) * c + m(2, 3)) / voxel_size_m;
      const bool valid = (range_m <= max_range_m) & (u >= -kEdge) & (v >= -kEdge) & (w >= -kEdge) &
                         (u < kEdge) & (v < kEdge) & (w < kEdge);
      const double from_edge_u = Floor(valid ? u : 0.0) + kEdge;
      const double from_edge_v = Floor(valid ? v : 0.0) + kEdge;
      const double from_edge_w = Floor(valid ? w : 0.0) + kEdge;
      const double packed = (from_edge_u * 65536.0 + from_edge_v) * 65536.0 + from_edge_w;
      key[k] = valid ? packed : -1.0;
    }
    for (int k = 0; k < count; ++k) {
      in.key[first + k] = static_cast<std::uint64_t>(static_cast<std::int64_t>(key[k]));
    }
  }
}

const std::vector<Kernels>& AllKernels() {
  static const std::vector<Kernels>* const kernels = [] {
    auto* all = new std::vector<Kernels>{{"plain", PlainMakeUnitVectors, PlainFindNearest}};
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
      all->push_back({"avx2", Avx2MakeUnitVectors, Avx2FindNearest});
    }
#endif
    return all;
  }();
  return *kernels;
}

}  // namespace soundmap::ray_casting
