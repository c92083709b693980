#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/likelihood_scan.h"
#include "acoustics/stft.h"
#include "frames/echo_ripple.h"

namespace soundmap::acoustics {

// The ripples that echoes leave in the spectra of a scan's peaks, from 100 to 2000 Hz: of the power
// of the delay-and-sum beam towards each peak, mean over the frames of the scan. Broad features,
// those of the source itself, are taken off with the mean over 500 Hz. Immutable.
class PeakRipple {
 public:
  // More peaks than these, which are the strongest, have no ripple.
  static constexpr int kMaxPeaks = 6;

  // Of one scan, what ripples are made of. The memory is used again.
  using Frames = std::vector<float>;

  PeakRipple(const FrameLayout& layout, double speed_of_sound_mps,
             const std::vector<Eigen::Vector3d>& mic_in_array_m);

  // Call for each frame 0 .. K-1 of a scan.
  void Keep(int frame, const FrameSpectra& spectra, Frames& frames) const;

  // One entry a peak, in their order, kMaxPeaks at most; empty ripples where the bins are too wide
  // or a bin is silent.
  std::vector<frames::EchoRipple> Ripples(const Frames& frames, std::span<const Peak> peaks) const;

 private:
  int microphones_;
  int frames_;
  int frame_floats_;  // of one microphone in one bin
  int window_samples_;
  int around_ = 0;                // bins on either side that the mean is over
  int first_ = 0, last_ = 0;      // bins of the ripple
  int last_kept_ = 0;             // bins 1 to there are kept
  double bin_waves_per_m_ = 0.0;  // of bin 1
  std::vector<Eigen::Vector3d> mic_in_array_m_;
};

}  // namespace soundmap::acoustics
