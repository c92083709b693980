#pragma once

#include <array>
#include <numbers>

namespace soundmap::frames {

// Octave bands of 125 Hz to 8 kHz.
inline constexpr int kOctaveBands = 7;

constexpr double OctaveCentre_hz(int band) { return 125.0 * (1 << band); }
constexpr double OctaveBegin_hz(int band) { return OctaveCentre_hz(band) / std::numbers::sqrt2; }
constexpr double OctaveEnd_hz(int band) { return OctaveCentre_hz(band) * std::numbers::sqrt2; }

// How many of them lie below half the sample rate as a whole.
constexpr int OctaveBandsAt(int sample_rate_hz) {
  int bands = 0;
  while (bands < kOctaveBands && 2.0 * OctaveEnd_hz(bands) <= sample_rate_hz) ++bands;
  return bands;
}

// Mean square of the sound in each band, beside that of a full-scale square wave, which is twice
// that of a full-scale sine.
using BandPowers = std::array<float, kOctaveBands>;

}  // namespace soundmap::frames
