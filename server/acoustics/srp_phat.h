#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "acoustics/config.h"
#include "acoustics/harmonic_srp.h"
#include "acoustics/kernels.h"
#include "acoustics/look_up_srp.h"
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
  // Cross-spectra of the microphone pairs, eq. (4): rows of bins, real parts and then imaginary.
  std::vector<float> cross;
  std::vector<float> workspace;  // what it was computed in, kept for the next scan
};

// Steered response power with the phase transform, eqs. (2)-(5). u_i and p_n are in mic_array, u_i
// points from the array to the source, and tau_n = 2 pi f (p_n . u_i) / c in eq. (3). 0 <= S <= B,
// reached by a plane wave from exactly u_i; incoherent noise averages B/N.
//
// |Y|^2 is expanded into the cross-spectra of the microphone pairs, which are averaged over the K
// frames (eq. 4). Pairs with one difference vector are one. S on a grid of rings is found by way of
// its spherical harmonics (HarmonicSrp); other grids, and arrays of many wavelengths, read one
// correlation value a pair in each direction (LookUpSrp). Which way is taken depends on the array
// and the grid alone. No power is off by more than 1e-5 B. Immutable; all members may be called on
// many threads at once, with the same bits as result.
class SrpPhat {
 public:
  // InvalidArgument: not 2 to 64 microphones, a position that is not finite, two microphones at one
  // place, an empty grid, an array so large that its delays exceed the table (about 16 000
  // half-periods of f_max).
  static absl::StatusOr<std::shared_ptr<const SrpPhat>> Create(
      const FrameLayout& layout, double speed_of_sound_mps,
      const std::vector<Eigen::Vector3d>& mic_in_array_m, geometry::DirectionGrid grid);

  // Into `scan`, whose memory is used again; or into a new one.
  void Scan(const PhatSpectra& spectra, AudioScan& scan) const;
  AudioScan Scan(const PhatSpectra& spectra) const {
    AudioScan scan;
    Scan(spectra, scan);
    return scan;
  }

  // Into `rest`: the scan without plane waves from these directions, strongest first. Each takes
  // with it what is left in its direction of every bin (CLEAN, bin by bin), whatever its spectrum;
  // the part of S that is the same in every direction stays.
  void Without(const AudioScan& scan, std::span<const Eigen::Vector3d> directions,
               AudioScan& rest) const;

  // S of eq. (5) in any direction.
  double PowerAt(const AudioScan& scan, const Eigen::Vector3d& direction) const;

  const geometry::DirectionGrid& grid() const { return grid_; }
  bool by_harmonics() const { return harmonic_ != nullptr; }
  int microphones() const { return microphones_; }
  int band_bins() const { return layout_.bins; }

 private:
  SrpPhat(const FrameLayout& layout, geometry::DirectionGrid grid, int microphones)
      : layout_(layout), grid_(std::move(grid)), microphones_(microphones) {}
  // The pairs' delay vectors (p_a - p_b) / c, longest first, those that are equal once.
  absl::Status GroupPairs(double speed_of_sound_mps,
                          const std::vector<Eigen::Vector3d>& mic_in_array_m);
  absl::Status Build(double speed_of_sound_mps, const std::vector<Eigen::Vector3d>& mic_in_array_m);

  // A plane wave, off the cross-spectra of `scan`.
  void TakeOff(const Eigen::Vector3d& direction, AudioScan& scan) const;
  // All but the cross-spectra and auto_power of `scan`, from them.
  void Steer(AudioScan& scan) const;
  std::size_t cross_floats() const;  // of all real parts
  // A pair counts twice: as (a, b) and as (b, a).
  float pair_scale() const {
    return 2.0f / (static_cast<float>(microphones_) * microphones_ * layout_.frames_per_scan);
  }

  FrameLayout layout_;
  geometry::DirectionGrid grid_;
  int microphones_;
  std::vector<Eigen::Vector3d> delay_s_;  // of the groups of pairs with one delay vector
  std::vector<float> pairs_of_group_;
  std::vector<PairTarget> target_;  // of a <= b; those of a = b belong to a group past the last
  std::unique_ptr<const HarmonicSrp> harmonic_;  // one or the other
  std::unique_ptr<const LookUpSrp> look_up_;
};

}  // namespace soundmap::acoustics
