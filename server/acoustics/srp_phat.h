#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "acoustics/config.h"
#include "acoustics/harmonic_srp.h"
#include "acoustics/kernels.h"
#include "acoustics/stft.h"
#include "geometry/directions.h"

namespace soundmap::acoustics {

// S(k) of section III: the power of every candidate direction.
struct AudioScan {
  std::vector<float> power;  // S(theta_i, phi_i, k) of eq. (5), in the order of the grid
  // What PowerAt() needs, one or the other: the spherical harmonics of S, or the cross-correlation
  // of every microphone pair in the band, as cubics of the delay, with the part of S that is the
  // same in every direction.
  std::vector<float> harmonics;
  std::vector<float> correlation;
  float auto_power = 0.0f;
};

// Steered response power with the phase transform, eqs. (2)-(5). u_i and p_n are in mic_array, u_i
// points from the array to the source, and tau_n = 2 pi f (p_n . u_i) / c in eq. (3). 0 <= S <= B,
// reached by a plane wave from exactly u_i; incoherent noise averages B/N.
//
// |Y|^2 is expanded into the cross-spectra of the microphone pairs, which are averaged over the K
// frames (eq. 4). Pairs with one difference vector are one. S of a grid in rings is found by way of
// its spherical harmonics (harmonic_srp.h). For other grids, and for arrays of many wavelengths,
// the cross-spectra are summed over the band (eq. 5) into correlations, and each direction reads
// one value a pair. Which way is taken depends on the array and the grid alone. No power is off by
// more than 1e-5 B. Immutable; all members may be called on many threads at once, with the same
// bits as result.
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

  // Eqs. (2)-(5) applied to a unit plane wave from `source`: the response in `direction`, B where
  // they are equal.
  double ResponseAt(const Eigen::Vector3d& source, const Eigen::Vector3d& direction) const;

  // power[i] += gain * (ResponseAt(source, grid()[i]) - offset), each response within 1e-2 B
  // (typically 1e-3 B); for all i, or for those of the sample.
  void AddResponse(const Eigen::Vector3d& source, float gain, float offset,
                   std::span<float> power) const;
  void AddResponseToSample(const Eigen::Vector3d& source, float gain, float offset,
                           std::span<float> power) const;
  // About 2000 directions or more, spread over the grid: enough for its statistics.
  bool InSample(int i) const { return i / 4 % sample_stride_ == 0; }

  // Standard deviation of S, in one direction, in noise that is independent at each microphone.
  double IncoherentSpread() const;

  // The directions that the array cannot tell from `direction` have the same image under this map:
  // itself in space, its mirror image for microphones in a plane, a cone for microphones in a line.
  // Image points of distinguishable directions are as far apart as they are.
  Eigen::Vector3d Distinguishable(const Eigen::Vector3d& direction) const;

  const geometry::DirectionGrid& grid() const { return grid_; }
  // 1: the microphones lie in a line, 2: in a plane, 3: in space.
  int array_rank() const { return array_rank_; }
  bool by_harmonics() const { return harmonic_ != nullptr; }
  int microphones() const { return microphones_; }
  int band_bins() const { return layout_.bins; }

 private:
  // Microphone pairs (a, b) with one difference vector p_a - p_b.
  struct PairGroup {
    Eigen::Vector3d delay_s;  // (p_a - p_b) / c
    int count = 0;
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
  void BuildResponse();
  std::int64_t FinePosition(const PairGroup& group, const Eigen::Vector3d& direction) const;
  std::vector<float> Correlate(const float* cross_real, const float* cross_imaginary,
                               int width) const;
  void ScanByLookUp(AudioScan& scan) const;
  void AddResponse(const Eigen::Vector3d& source, float gain, float offset, int stride,
                   std::span<float> power) const;
  int Tiles() const;

  FrameLayout layout_;
  geometry::DirectionGrid grid_;
  int microphones_;
  std::vector<PairGroup> groups_;   // longest first
  std::vector<PairTarget> target_;  // of a <= b; those of a = b belong to the group past the last
  std::unique_ptr<const HarmonicSrp> harmonic_;  // null: by look-up
  int sample_stride_ = 1;                        // in cells
  int array_rank_ = 3;
  Eigen::Vector3d array_axis_ = Eigen::Vector3d::UnitZ();  // of a line; normal of a plane

  double lag_step_s_ = 0.0;
  int max_lag_ = 0;    // samples of the correlation lie at -max_lag_ .. max_lag_
  int intervals_ = 0;  // interval j spans lags j - centre_ .. j - centre_ + 1
  int centre_ = 0;
  Eigen::MatrixXf even_basis_;   // cos(2 pi f l lag_step), lags 0 .. max_lag_ by bins
  Eigen::MatrixXf odd_basis_;    // sin
  Eigen::MatrixXf cubic_;        // 4 coefficients by taps
  std::vector<Cell> cells_;      // tile by tile, group by group, four directions each
  std::vector<float> response_;  // sum over the band of cos(2 pi f tau), by delay
  int response_centre_ = 0;
};

}  // namespace soundmap::acoustics
