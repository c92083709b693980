#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/likelihood_scan.h"
#include "acoustics/stft.h"
#include "frames/octave_bands.h"

namespace soundmap::acoustics {

// How loud the sources are whose directions the peaks are: the power that each brings to the array,
// by octave band. Per band the delay-and-sum powers b_i of the peaks' directions, which see each
// other through the array's beam G_ij, and the mean power p of the microphones make
//   b_i = sum_j G_ij s_j + n / N,   p = sum_j s_j + n
// for the sources' powers s_j and the sound n that is independent at each microphone. In a band
// where the beam cannot tell two peaks apart, what is coherent is shared by their S. From one frame
// alone s_j may be off by decibels, or negative, but its mean over many frames is not: average,
// then take logarithms. Immutable.
class PeakLevel {
 public:
  // More peaks than these, which are the strongest, have no level.
  static constexpr int kMaxPeaks = 6;

  PeakLevel(const FrameLayout& layout, double speed_of_sound_mps,
            const std::vector<Eigen::Vector3d>& mic_in_array_m);

  // One entry a peak, in their order, kMaxPeaks at most. Bands from bands() on are 0.
  std::vector<frames::BandPowers> Levels(const FrameSpectra& frame,
                                         std::span<const Peak> peaks) const;
  int bands() const { return bands_; }

 private:
  struct Bin {
    int bin;
    int band;
  };

  int bands_;
  int microphones_;
  int window_samples_;
  double bin_rad_per_m_;  // wave number of bin 1
  std::vector<Eigen::Vector3d> mic_in_array_m_;
  std::vector<Bin> bins_;  // eight an octave, that the beams are formed in
  std::array<int, frames::kOctaveBands + 1> first_bin_of_band_{};  // of all bins
};

}  // namespace soundmap::acoustics
