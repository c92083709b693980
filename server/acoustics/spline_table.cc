#include "acoustics/spline_table.h"

#include <cstdint>
#include <cstring>

#include "acoustics/float4.h"

// Compiled without fused multiply-add.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // wide vectors are passed to inlined functions only
#endif

namespace soundmap::acoustics {
namespace {

#define SOUNDMAP_INLINE_LAMBDA __attribute__((always_inline))
#define SOUNDMAP_INLINE inline SOUNDMAP_INLINE_LAMBDA

// Four numbers a half: one half for any processor, two where AVX2 is. All is done number by number
// in the same order, so that both give the same bits.
template <int halves>
struct Vector {
  typedef float Floats __attribute__((vector_size(16 * halves)));
  typedef std::int32_t Ints __attribute__((vector_size(16 * halves)));
};
template <int halves>
using Floats = typename Vector<halves>::Floats;
template <int halves>
using Ints = typename Vector<halves>::Ints;

template <int halves>
SOUNDMAP_INLINE Floats<halves> Load(const float* p) {  // of any alignment
  Floats<halves> value;
  std::memcpy(&value, p, sizeof(value));
  return value;
}

// A half from each place.
template <int halves>
SOUNDMAP_INLINE Floats<halves> LoadHalves(const float* first, const float* second) {
  if constexpr (halves == 1) {
    return LoadFloat4(first);
  } else {
    return __builtin_shufflevector(LoadFloat4(first), LoadFloat4(second), 0, 1, 2, 3, 4, 5, 6, 7);
  }
}

Float4 Splat(float value) { return Float4{value, value, value, value}; }

// One number of each half, in all its places.
template <int halves, int lane>
SOUNDMAP_INLINE Floats<halves> Spread(const Floats<halves>& v) {
  if constexpr (halves == 1) {
    return __builtin_shufflevector(v, v, lane, lane, lane, lane);
  } else {
    return __builtin_shufflevector(v, v, lane, lane, lane, lane, 4 + lane, 4 + lane, 4 + lane,
                                   4 + lane);
  }
}

// Rows to columns, in each half.
template <int halves>
SOUNDMAP_INLINE void TransposeHalves(Floats<halves> (&r)[4]) {
  if constexpr (halves == 1) {
    Transpose(r[0], r[1], r[2], r[3]);
  } else {
    const Floats<2> ab_low = __builtin_shufflevector(r[0], r[1], 0, 8, 1, 9, 4, 12, 5, 13);
    const Floats<2> ab_high = __builtin_shufflevector(r[0], r[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const Floats<2> cd_low = __builtin_shufflevector(r[2], r[3], 0, 8, 1, 9, 4, 12, 5, 13);
    const Floats<2> cd_high = __builtin_shufflevector(r[2], r[3], 2, 10, 3, 11, 6, 14, 7, 15);
    r[0] = __builtin_shufflevector(ab_low, cd_low, 0, 1, 8, 9, 4, 5, 12, 13);
    r[1] = __builtin_shufflevector(ab_low, cd_low, 2, 3, 10, 11, 6, 7, 14, 15);
    r[2] = __builtin_shufflevector(ab_high, cd_high, 0, 1, 8, 9, 4, 5, 12, 13);
    r[3] = __builtin_shufflevector(ab_high, cd_high, 2, 3, 10, 11, 6, 7, 14, 15);
  }
}

// The four cubic B-splines that are not zero at t = 0 .. 1 after a knot.
template <int halves>
struct Weights {
  Floats<halves> tap[4];
};
template <int halves>
SOUNDMAP_INLINE Weights<halves> BSpline(const Floats<halves>& t) {
  constexpr float kSixth = 1.0f / 6.0f;
  const Floats<halves> rest = 1.0f - t;
  Weights<halves> w;
  w.tap[0] = kSixth * rest * rest * rest;
  w.tap[1] = 2.0f / 3.0f - 0.5f * t * t * (2.0f - t);
  w.tap[2] = 2.0f / 3.0f - 0.5f * rest * rest * (1.0f + t);
  w.tap[3] = kSixth * t * t * t;
  return w;
}

// The taps across one number of each half: four columns of the table, weighted down the rows and,
// in space, the planes.
template <int rank, int halves, int lane>
SOUNDMAP_INLINE Floats<halves> ColumnsOf(const SplineTable& table, const Ints<halves>& base,
                                         const Weights<halves> (&weights)[3]) {
  const float* const first = table.coefficient + base[lane];
  const float* const second = table.coefficient + base[lane + 4 * (halves - 1)];
  const auto row_sum = [&](std::ptrdiff_t at) SOUNDMAP_INLINE_LAMBDA {
    const std::ptrdiff_t stride = table.length[2];
    Floats<halves> sum =
        Spread<halves, lane>(weights[1].tap[0]) * LoadHalves<halves>(first + at, second + at);
    for (int tap = 1; tap < 4; ++tap) {
      sum += Spread<halves, lane>(weights[1].tap[tap]) *
             LoadHalves<halves>(first + at + tap * stride, second + at + tap * stride);
    }
    return sum;
  };
  if constexpr (rank == 1) {
    return LoadHalves<halves>(first, second);
  } else if constexpr (rank == 2) {
    return row_sum(0);
  } else {
    const std::ptrdiff_t plane = static_cast<std::ptrdiff_t>(table.length[1]) * table.length[2];
    Floats<halves> sum = Spread<halves, lane>(weights[0].tap[0]) * row_sum(0);
    for (int tap = 1; tap < 4; ++tap) {
      sum += Spread<halves, lane>(weights[0].tap[tap]) * row_sum(tap * plane);
    }
    return sum;
  }
}

// The values at coordinates in steps.
template <int rank, int halves>
SOUNDMAP_INLINE Floats<halves> FromTable(const SplineTable& table, const Floats<halves> (&at)[3]) {
  // The first coordinate is brought above 0: the response is even.
  constexpr int kFirst = 3 - rank;
  const Ints<halves> sign = __builtin_bit_cast(Ints<halves>, at[kFirst]) & INT32_MIN;
  Ints<halves> base = {};
  Weights<halves> weights[3];
  for (int axis = kFirst; axis < 3; ++axis) {
    const Ints<halves> bits = __builtin_bit_cast(Ints<halves>, at[axis]) ^ sign;
    const Floats<halves> steps =
        __builtin_bit_cast(Floats<halves>, bits) - static_cast<float>(table.begin[axis]);
    const Ints<halves> whole = __builtin_convertvector(steps, Ints<halves>);
    weights[axis] = BSpline<halves>(steps - __builtin_convertvector(whole, Floats<halves>));
    base = base * table.length[axis] + (whole - 1);
  }
  TransposeHalves<halves>(weights[2].tap);
  Floats<halves> sum[4] = {ColumnsOf<rank, halves, 0>(table, base, weights) * weights[2].tap[0],
                           ColumnsOf<rank, halves, 1>(table, base, weights) * weights[2].tap[1],
                           ColumnsOf<rank, halves, 2>(table, base, weights) * weights[2].tap[2],
                           ColumnsOf<rank, halves, 3>(table, base, weights) * weights[2].tap[3]};
  TransposeHalves<halves>(sum);
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

// See SplineTable::Add().
template <int rank, int halves>
SOUNDMAP_INLINE void AddTo(const SplineTable& table, const float* const (&at)[3],
                           const Eigen::Vector3f& origin, float gain, float offset,
                           std::span<float> power) {
  constexpr int kLanes = 4 * halves;
  const auto values = [&](std::size_t i) SOUNDMAP_INLINE_LAMBDA {
    const Floats<halves> difference[3] = {Load<halves>(at[0] + i) - origin[0],
                                          Load<halves>(at[1] + i) - origin[1],
                                          Load<halves>(at[2] + i) - origin[2]};
    return FromTable<rank, halves>(table, difference);
  };
  std::size_t i = 0;
  for (; i + kLanes <= power.size(); i += kLanes) {
    const Floats<halves> sum = Load<halves>(&power[i]) + gain * (values(i) - offset);
    std::memcpy(&power[i], &sum, sizeof(sum));
  }
  if (i == power.size()) return;
  const Floats<halves> rest = gain * (values(i) - offset);
  for (int lane = 0; i < power.size(); ++i, ++lane) power[i] += rest[lane];
}

using AddValues = void (*)(const SplineTable&, const float* const (&)[3], const Eigen::Vector3f&,
                           float, float, std::span<float>);

template <int rank>
void PlainAddValues(const SplineTable& table, const float* const (&at)[3],
                    const Eigen::Vector3f& origin, float gain, float offset,
                    std::span<float> power) {
  AddTo<rank, 1>(table, at, origin, gain, offset, power);
}
#if defined(__x86_64__)
template <int rank>
__attribute__((target("avx2"))) void Avx2AddValues(const SplineTable& table,
                                                   const float* const (&at)[3],
                                                   const Eigen::Vector3f& origin, float gain,
                                                   float offset, std::span<float> power) {
  AddTo<rank, 2>(table, at, origin, gain, offset, power);
}
#endif

template <int rank>
AddValues FastestOf() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) return Avx2AddValues<rank>;
#endif
  return PlainAddValues<rank>;
}

}  // namespace

float SplineTable::At(const Eigen::Vector3f& steps) const {
  const Float4 at[3] = {Splat(steps[0]), Splat(steps[1]), Splat(steps[2])};
  return (rank == 3   ? FromTable<3, 1>(*this, at)
          : rank == 2 ? FromTable<2, 1>(*this, at)
                      : FromTable<1, 1>(*this, at))[0];
}

void SplineTable::Add(const float* const (&coordinate)[3], const Eigen::Vector3f& origin,
                      float gain, float offset, std::span<float> power, bool plain) const {
  static constexpr AddValues kPlain[3] = {PlainAddValues<1>, PlainAddValues<2>, PlainAddValues<3>};
  static const AddValues fastest[3] = {FastestOf<1>(), FastestOf<2>(), FastestOf<3>()};
  (plain ? kPlain : fastest)[rank - 1](*this, coordinate, origin, gain, offset, power);
}

}  // namespace soundmap::acoustics
