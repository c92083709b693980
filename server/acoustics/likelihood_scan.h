#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "frames/echo_ripple.h"
#include "frames/frames.h"
#include "frames/octave_bands.h"

namespace soundmap::acoustics {

// A local maximum of the power of one audio scan.
struct Peak {
  Eigen::Vector3d direction_in_array = Eigen::Vector3d::UnitX();  // unit vector, array to source
  double power = 0.0;       // S of eq. (5), less the responses of the peaks found before
  bool reflection = false;  // the mirror image of a stronger peak's source: no evidence
  // Of the flat surface where its direction ends, towards the array; 0: none such is known.
  Eigen::Vector3d surface_normal_in_array = Eigen::Vector3d::Zero();
};

// The result of section IV for one audio scan: the likelihood of a sound source in each candidate
// direction.
struct LikelihoodScan {
  frames::TimeNs begin_ns = 0;  // first sample
  frames::TimeNs end_ns = 0;    // after the last sample
  // Empty: usable. Otherwise why this scan says nothing (a dead microphone, a gap), and
  // `likelihood` is empty.
  std::string fault;
  // Microphones that are dead and were done without, in channel order.
  std::vector<int> dead_microphones;
  // Microphones of inverted polarity, whose sign was turned, in channel order.
  std::vector<int> inverted_microphones;
  std::vector<float> likelihood;  // L(theta_i, phi_i, k), in the order of the grid
  double noise_floor = 0.0;       // of S; 0 where the profile does not estimate it
  std::vector<Peak> peaks;        // strongest first
  // Where in the grid the whole power has local maxima, also those that are too low for a peak.
  std::vector<int> maxima;
  // What the strongest of them bring to the array, in their order; see PeakLevel. One frame of the
  // scan: take means.
  std::vector<frames::BandPowers> levels;
  // What echoes leave in the spectra of the strongest of them, in their order; see PeakRipple. Of
  // microphones in a plane alone.
  std::vector<frames::EchoRipple> ripples;

  frames::TimeNs mid_ns() const { return begin_ns + (end_ns - begin_ns) / 2; }
};

}  // namespace soundmap::acoustics
