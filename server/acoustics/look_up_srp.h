#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "acoustics/config.h"
#include "geometry/directions.h"

namespace soundmap::acoustics {

// The power of all directions from the cross-spectra of the microphone pairs, by way of their
// correlations: the cross-spectra are summed over the band (eq. 5) into one function of the delay a
// pair, kept as cubics, of which each direction reads one value a pair. For any grid and for arrays
// of many wavelengths. The cubics are chosen so that no power is off by more than 1e-5 B.
// Immutable; thread safe.
class LookUpSrp {
 public:
  // `delay_s`: the pairs' delay vectors, longest first. InvalidArgument: they exceed the table.
  static absl::StatusOr<std::unique_ptr<const LookUpSrp>> Create(
      const FrameLayout& layout, const std::vector<Eigen::Vector3d>& delay_s,
      const geometry::DirectionGrid& grid);

  // `scale` times the correlation of every pair, the sum over the bins of Re(C e^{-j w tau}). The
  // cross-spectra C are pair by pair, in rows of `width` bins.
  std::vector<float> Correlate(const float* cross_real, const float* cross_imaginary, int width,
                               float scale) const;
  // value[i] = constant + the sum of the correlations in direction i of the grid.
  void Read(std::span<const float> correlation, float constant, std::span<float> value) const;
  // Their sum in any one direction.
  double SumAt(std::span<const float> correlation, const Eigen::Vector3d& direction) const;

 private:
  // Where four neighbouring directions read a pair's correlation.
  struct alignas(16) Cell {
    std::uint16_t interval_x2[4];
    std::uint16_t fraction[4];  // of the interval, in 2^-16
  };

  LookUpSrp(const FrameLayout& layout, const std::vector<Eigen::Vector3d>& delay_s)
      : layout_(layout), delay_s_(delay_s) {}
  void BuildInterpolator();
  void BuildCells(const geometry::DirectionGrid& grid);

  FrameLayout layout_;
  std::vector<Eigen::Vector3d> delay_s_;
  double lag_step_s_ = 0.0;
  int max_lag_ = 0;    // samples of the correlation lie at -max_lag_ .. max_lag_
  int intervals_ = 0;  // interval j spans lags j - centre_ .. j - centre_ + 1
  int centre_ = 0;
  Eigen::MatrixXf even_basis_;  // cos(2 pi f l lag_step), lags 0 .. max_lag_ by bins
  Eigen::MatrixXf odd_basis_;   // sin
  Eigen::MatrixXf cubic_;       // 4 coefficients by taps
  int tiles_ = 0;
  std::vector<Cell> cells_;  // tile by tile, pair by pair, four directions each
};

}  // namespace soundmap::acoustics
