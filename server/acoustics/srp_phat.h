#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "acoustics/config.h"
#include "acoustics/stft.h"
#include "geometry/directions.h"

namespace soundmap::acoustics {

// S(k) of section III: the power of every candidate direction.
struct AudioScan {
  std::vector<float> power;  // S(theta_i, phi_i, k) of eq. (5), in the order of the grid
  // What PowerAt() needs: the cross-correlation of every microphone pair in the band, as cubics of
  // the delay.
  std::vector<float> correlation;
  float auto_power = 0.0f;  // the part of S that is the same in every direction
};

// Steered response power with the phase transform, eqs. (2)-(5). u_i and p_n are in mic_array, u_i
// points from the array to the source, and tau_n = 2 pi f (p_n . u_i) / c in eq. (3). 0 <= S <= B,
// reached by a plane wave from exactly u_i; incoherent noise averages B/N.
//
// |Y|^2 is expanded into the cross-spectra of the microphone pairs, which are averaged over the K
// frames (eq. 4) and summed over the band (eq. 5) first; each direction then reads one correlation
// value a pair. Pairs with one difference vector are one. The cubics are chosen so that no power is
// off by more than 1e-5 B. Immutable; all members may be called on many threads at once, with the
// same bits as result.
class SrpPhat {
 public:
  // InvalidArgument: not 2 to 64 microphones, a position that is not finite, two microphones at one
  // place, an empty grid, an array so large that its delays exceed the table (about 16 000
  // half-periods of f_max).
  static absl::StatusOr<std::shared_ptr<const SrpPhat>> Create(
      const FrameLayout& layout, double speed_of_sound_mps,
      const std::vector<Eigen::Vector3d>& mic_in_array_m, geometry::DirectionGrid grid);

  AudioScan Scan(const PhatSpectra& spectra) const;

  // S of eq. (5) in any direction.
  double PowerAt(const AudioScan& scan, const Eigen::Vector3d& direction) const;

  const geometry::DirectionGrid& grid() const { return grid_; }
  int microphones() const { return microphones_; }
  int band_bins() const { return layout_.bins; }

 private:
  // Microphone pairs (a, b) with one difference vector p_a - p_b.
  struct PairGroup {
    Eigen::Vector3d delay_s;  // (p_a - p_b) / c
    int first = 0;            // in pairs_
    int count = 0;
  };
  struct Pair {
    int a;
    int b;
  };
  // Where four neighbouring directions read a pair's correlation.
  struct alignas(16) Cell {
    std::uint16_t interval_x2[4];
    std::uint16_t fraction[4];  // of the interval, in 2^-16
  };

  SrpPhat(const FrameLayout& layout, geometry::DirectionGrid grid, int microphones)
      : layout_(layout), grid_(std::move(grid)), microphones_(microphones) {}
  absl::Status Build(double speed_of_sound_mps, const std::vector<Eigen::Vector3d>& mic_in_array_m);
  void BuildInterpolator(double max_delay_s);
  void BuildCells();
  std::int64_t FinePosition(const PairGroup& group, const Eigen::Vector3d& direction) const;
  std::vector<float> Correlate(const PhatSpectra& spectra, float* auto_power) const;
  int Tiles() const;

  FrameLayout layout_;
  geometry::DirectionGrid grid_;
  int microphones_;
  std::vector<PairGroup> groups_;
  std::vector<Pair> pairs_;

  double lag_step_s_ = 0.0;
  int max_lag_ = 0;    // samples of the correlation lie at -max_lag_ .. max_lag_
  int intervals_ = 0;  // interval j spans lags j - centre_ .. j - centre_ + 1
  int centre_ = 0;
  Eigen::MatrixXf even_basis_;  // cos(2 pi f l lag_step), lags 0 .. max_lag_ by bins
  Eigen::MatrixXf odd_basis_;   // sin
  Eigen::MatrixXf cubic_;       // 4 coefficients by taps
  std::vector<Cell> cells_;     // tile by tile, group by group, four directions each
};

}  // namespace soundmap::acoustics
