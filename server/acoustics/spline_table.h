#pragma once

#include <Eigen/Core>
#include <span>

namespace soundmap::acoustics {

// An even function in space, in a plane or on a line, as coefficients of cubic B-splines over the
// last `rank` of three coordinates, in steps; the last one runs fastest. The first coordinate that
// counts has no coefficients below 0 but for those that splines at 0 need.
struct SplineTable {
  // Coordinates are readable so far behind the last one.
  static constexpr int kPadding = 8;

  const float* coefficient = nullptr;
  int rank = 3;
  int begin[3] = {0, 0, 0};
  int length[3] = {1, 1, 1};

  float At(const Eigen::Vector3f& steps) const;

  // power[i] += gain * (the value at coordinate[.][i] - origin - offset). `plain`: as on a
  // processor without AVX2, with the same bits.
  void Add(const float* const (&coordinate)[3], const Eigen::Vector3f& origin, float gain,
           float offset, std::span<float> power, bool plain) const;
};

}  // namespace soundmap::acoustics
