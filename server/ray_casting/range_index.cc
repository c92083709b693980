#include "ray_casting/range_index.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

typedef float Float4 __attribute__((vector_size(16)));
typedef std::int32_t Int4 __attribute__((vector_size(16)));
constexpr int kLanes = 4;

Float4 Load(const float* p) {
  Float4 value;
  std::memcpy(&value, p, sizeof(value));
  return value;
}

// Every lane becomes the least of all.
template <typename Vector>
void SpreadLeast(Vector& v) {
  Vector other = __builtin_shufflevector(v, v, 2, 3, 0, 1);
  v = other < v ? other : v;
  other = __builtin_shufflevector(v, v, 1, 0, 3, 2);
  v = other < v ? other : v;
}

// Cells are bands of elevation, cut by azimuth. Both are told by ratios that grow with the angle,
// by 0.5 to 1 a radian: no trigonometry.
constexpr int kBands = 96;

// -1 at -z, 0 in the x-y plane, 1 at z.
template <typename Value>
Value ElevationRatio(Value magnitude_z, Value z, Value across) {
  return z / (magnitude_z + across + std::numeric_limits<float>::min());
}
// 0 at x, 1 at y, 2 at -x, up to 4.
template <typename Value>
Value AzimuthRatio(Value magnitude_x, Value magnitude_y, Value x, Value y) {
  const Value t = x / (magnitude_x + magnitude_y + std::numeric_limits<float>::min());
  return y >= 0.0f ? 1.0f - t : 3.0f + t;
}

Float4 Abs(Float4 value) { return std::bit_cast<Float4>(std::bit_cast<Int4>(value) & INT32_MAX); }
Float4 Sqrt(Float4 value) {
  return Float4{std::sqrt(value[0]), std::sqrt(value[1]), std::sqrt(value[2]), std::sqrt(value[3])};
}

struct Bands {
  std::array<std::int32_t, kBands + 1> first;  // cell of each
  std::array<float, kBands> per_ratio;         // cells a unit of azimuth ratio

  Bands() {
    first[0] = 0;
    for (int band = 0; band < kBands; ++band) {
      // The wider edge.
      const double low = 2.0 * band / kBands - 1.0;
      const double ratio = low < 0.0 ? std::max(0.0, -low - 2.0 / kBands) : low;
      const double circumference = (1.0 - ratio) / std::hypot(ratio, 1.0 - ratio);
      const int quarter = std::max(1, static_cast<int>(std::lround(0.5 * kBands * circumference)));
      per_ratio[band] = static_cast<float>(quarter);
      first[band + 1] = first[band] + 4 * quarter;
    }
  }
  int cells() const { return first[kBands]; }
};

const Bands& AllBands() {
  static const Bands bands;
  return bands;
}

int BandOf(float elevation_ratio) {
  return std::clamp(static_cast<int>((elevation_ratio + 1.0f) * (kBands / 2)), 0, kBands - 1);
}

// Ratios and unit vectors are this exact.
constexpr float kRounding = 2e-6f;

}  // namespace

struct RangeIndex::Query {
  explicit Query(const Eigen::Vector3d& v)
      : direction(v),
        x(static_cast<float>(v.x())),
        y(static_cast<float>(v.y())),
        z(static_cast<float>(v.z())),
        across(std::sqrt(x * x + y * y)),
        elevation_ratio(ElevationRatio(std::abs(z), z, across)),
        azimuth_ratio(AzimuthRatio(std::abs(x), std::abs(y), x, y)) {}

  const Eigen::Vector3d& direction;
  float x, y, z;
  float across;  // cosine of the elevation
  float elevation_ratio;
  float azimuth_ratio;
};

RangeIndex::RangeIndex(std::span<const Eigen::Vector3f> points, const Eigen::Vector3d& origin,
                       double max_angle_rad)
    : points_(points),
      origin_(origin),
      epsilon_(1.0 - std::cos(max_angle_rad)),
      // A little more, so that rounding cannot hide a point that passes the test with epsilon.
      max_chord_(static_cast<float>(2.0 * std::sin(0.5 * max_angle_rad)) * (1.0f + 1e-6f) +
                 kRounding) {
  const auto count = static_cast<double>(std::max<std::size_t>(points.size(), 1));
  near_ = std::min(static_cast<float>(std::sqrt(4.0 * geometry::kPi / count)), max_chord_);
  SortIntoCells();
}

void RangeIndex::SortIntoCells() {
  const Bands& bands = AllBands();
  const std::size_t count = points_.size();
  const std::size_t padded = (count / kLanes + 2) * kLanes;
  storage_ = std::make_unique_for_overwrite<float[]>(6 * padded);
  point_ = std::make_unique_for_overwrite<std::int32_t[]>(padded);
  const auto cell_of = std::make_unique_for_overwrite<std::uint16_t[]>(padded);
  begin_.assign(bands.cells() + 2, 0);
  const int nowhere = bands.cells();

  float* const unit[3] = {&storage_[0], &storage_[padded], &storage_[2 * padded]};
  // The difference of the points and the origin is as exact in two steps as in double precision.
  float origin_high[3];
  float origin_low[3];
  for (int axis = 0; axis < 3; ++axis) {
    origin_high[axis] = static_cast<float>(origin_[axis]);
    origin_low[axis] = static_cast<float>(origin_[axis] - origin_high[axis]);
  }
  for (std::size_t j = 0; j < count; j += kLanes) {
    const auto point = [&](std::size_t lane) -> const Eigen::Vector3f& {
      return points_[std::min(j + lane, count - 1)];
    };
    Float4 v[3];
    for (int axis = 0; axis < 3; ++axis) {
      v[axis] = Float4{point(0)[axis], point(1)[axis], point(2)[axis], point(3)[axis]};
      v[axis] = (v[axis] - origin_high[axis]) - origin_low[axis];
    }
    const Float4 square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    const Float4 inverse = 1.0f / Sqrt(square);
    for (Float4& axis : v) axis *= inverse;
    for (int lane = 0; lane < kLanes; ++lane) {
      // Beyond, squares of floats are not exact.
      constexpr float kLeast_m2 = 1e-24f;
      constexpr float kMost_m2 = 1e24f;
      if (square[lane] > kLeast_m2 && square[lane] < kMost_m2) continue;
      const Eigen::Vector3d exact = point(lane).cast<double>() - origin_;
      const double range_m = exact.norm();
      for (int axis = 0; axis < 3; ++axis)
        v[axis][lane] = static_cast<float>(exact[axis] / range_m);
    }
    for (int axis = 0; axis < 3; ++axis) std::memcpy(unit[axis] + j, &v[axis], sizeof(v[axis]));
    const Float4 elevation_ratio = ElevationRatio(Abs(v[2]), v[2], Sqrt(v[0] * v[0] + v[1] * v[1]));
    const Float4 azimuth_ratio = AzimuthRatio(Abs(v[0]), Abs(v[1]), v[0], v[1]);
    const Int4 band_of = __builtin_convertvector((elevation_ratio + 1.0f) * (kBands / 2), Int4);
    const Int4 found = v[0] == v[0];  // not a number: at the origin, or not finite
    for (int lane = 0; lane < kLanes; ++lane) {
      int cell = nowhere;
      if (found[lane] != 0) {
        const int band = std::min(band_of[lane], kBands - 1);
        cell = std::min(
            bands.first[band] + static_cast<int>(azimuth_ratio[lane] * bands.per_ratio[band]),
            bands.first[band + 1] - 1);
      }
      cell_of[j + lane] = static_cast<std::uint16_t>(cell);
    }
  }
  for (std::size_t j = 0; j < count; ++j) ++begin_[cell_of[j] + 1];
  for (std::size_t cell = 1; cell < begin_.size(); ++cell) begin_[cell] += begin_[cell - 1];

  float* const sorted[3] = {&storage_[3 * padded], &storage_[4 * padded], &storage_[5 * padded]};
  std::vector<std::int32_t> next(begin_.begin(), begin_.end() - 1);
  for (std::size_t j = 0; j < count; ++j) {
    const std::int32_t at = next[cell_of[j]]++;
    for (int axis = 0; axis < 3; ++axis) sorted[axis][at] = unit[axis][j];
    point_[at] = static_cast<std::int32_t>(j);
  }
  for (int axis = 0; axis < 3; ++axis) {
    unit_[axis] = sorted[axis];
    // What is read beyond the end is far from all directions.
    std::fill(sorted[axis] + count, sorted[axis] + padded, 4.0f);
  }
  std::fill(point_.get() + count, point_.get() + padded, 0);
}

// The cells that can hold a point within the angle, in rows. Returns how many ranges.
int RangeIndex::RangesWithin(const Query& query, float angle_rad, Range* ranges) const {
  const Bands& bands = AllBands();
  const float elevation_reach = angle_rad + kRounding;
  const int low = BandOf(query.elevation_ratio - elevation_reach);
  const int high = BandOf(query.elevation_ratio + elevation_reach);
  // Points within the angle lie within asin(sin(angle) / cos(elevation)) of azimuth, unless a pole
  // is within the angle as well.
  const bool pole = angle_rad >= query.across;
  const float sine = pole ? 1.0f : angle_rad / query.across;
  const float azimuth_reach = sine * (1.0f + 0.5708f * sine * sine) + kRounding;
  int count = 0;
  for (int band = low; band <= high; ++band) {
    const int first = bands.first[band];
    const int cells = bands.first[band + 1] - first;
    const float per_ratio = bands.per_ratio[band];
    // Counted from a turn before, so that it rounds down.
    const int from =
        static_cast<int>((query.azimuth_ratio - azimuth_reach) * per_ratio + cells) - cells;
    const int to = static_cast<int>((query.azimuth_ratio + azimuth_reach) * per_ratio);
    if (pole || to - from + 1 >= cells) {
      ranges[count++] = {begin_[first], begin_[first + cells]};
      continue;
    }
    ranges[count++] = {begin_[first + std::max(from, 0)], begin_[first + std::min(to + 1, cells)]};
    if (from < 0) ranges[count++] = {begin_[first + cells + from], begin_[first + cells]};
    if (to >= cells) ranges[count++] = {begin_[first], begin_[first + to + 1 - cells]};
  }
  return count;
}

RangeIndex::Least RangeIndex::FindLeast(const Query& query, const Range* ranges, int count) const {
  constexpr float kFar = 16.0f;
  Float4 least = Float4{} + kFar;
  Float4 next = least;
  Int4 at = Int4{} - 1;
  for (int r = 0; r < count; ++r) {
    // Lanes past the end of the range are points of cells nearby, which count as well.
    for (std::int32_t i = ranges[r].begin; i < ranges[r].end; i += kLanes) {
      const Float4 x = Load(unit_[0] + i) - query.x;
      const Float4 y = Load(unit_[1] + i) - query.y;
      const Float4 z = Load(unit_[2] + i) - query.z;
      const Float4 chord2 = x * x + y * y + z * z;
      const Int4 nearer = chord2 < least;
      const Float4 loser = nearer ? least : chord2;
      next = loser < next ? loser : next;
      least = nearer ? chord2 : least;
      at = nearer ? Int4{0, 1, 2, 3} + i : at;
    }
  }
  Float4 nearest = least;
  SpreadLeast(nearest);
  constexpr std::int32_t kNone = std::numeric_limits<std::int32_t>::max();
  const Int4 none = Int4{} + kNone;
  Int4 best = least == nearest ? at : none;
  SpreadLeast(best);
  Float4 others = at == best ? next : least;
  SpreadLeast(others);
  return {nearest[0], best[0], others[0]};
}

double RangeIndex::ExactDot(int point, const Eigen::Vector3d& direction) const {
  const double x = points_[point].x() - origin_.x();
  const double y = points_[point].y() - origin_.y();
  const double z = points_[point].z() - origin_.z();
  const double range_m = std::sqrt(x * x + y * y + z * z);
  return x / range_m * direction.x() + y / range_m * direction.y() + z / range_m * direction.z();
}

// Of all points within the limit, the nearest in double precision.
int RangeIndex::DecideInDouble(const Query& query, const Range* ranges, int count,
                               float limit_chord2) const {
  int best = -1;
  double best_dot = 0.0;
  for (int r = 0; r < count; ++r) {
    const std::int32_t end = std::min<std::int32_t>(ranges[r].end + kLanes - 1, begin_.back());
    for (std::int32_t i = ranges[r].begin; i < end; ++i) {
      const float x = unit_[0][i] - query.x;
      const float y = unit_[1][i] - query.y;
      const float z = unit_[2][i] - query.z;
      if (!(x * x + y * y + z * z <= limit_chord2)) continue;
      const double dot = ExactDot(point_[i], query.direction);
      if (best < 0 || dot > best_dot || (dot == best_dot && point_[i] < best)) {
        best_dot = dot;
        best = point_[i];
      }
    }
  }
  return best;
}

std::optional<RangeIndex::Hit> RangeIndex::Nearest(const Eigen::Vector3d& direction) const {
  if (!direction.allFinite()) return std::nullopt;
  const Query query(direction);
  // A look around the direction mostly finds some point; a nearer one can then only be within that
  // one's distance.
  constexpr float kAngleOfChord = 1.05f;  // at most, up to 60 degrees
  Range ranges[2 * kBands];
  int count = RangesWithin(query, kAngleOfChord * near_, ranges);
  Least least = FindLeast(query, ranges, count);
  const float chord = std::min(std::sqrt(least.chord2) + kRounding, max_chord_);
  if (chord > near_) {
    count = RangesWithin(query, kAngleOfChord * chord, ranges);
    least = FindLeast(query, ranges, count);
  }
  if (least.chord2 > 4.0f) return std::nullopt;
  // Where single precision cannot tell two points apart, or a point from the limit.
  const float undecided = 2.0f * kRounding * std::sqrt(least.chord2) + 1e-11f;
  const int point = least.next_chord2 > least.chord2 + undecided
                        ? point_[least.at]
                        : DecideInDouble(query, ranges, count, least.chord2 + undecided);
  const double cost = 0.5 * least.chord2;
  const bool within = std::abs(cost - epsilon_) > undecided
                          ? cost < epsilon_
                          : 1.0 - ExactDot(point, direction) < epsilon_;
  if (!within) return std::nullopt;
  return Hit{point, (points_[point].cast<double>() - origin_).norm()};
}

}  // namespace soundmap::ray_casting
