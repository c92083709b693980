#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <random>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/srp_phat.h"
#include "acoustics/stft.h"
#include "frames/frames.h"

// What a microphone array hears in the free field, made from arrival times alone: a wave from
// direction u reaches microphone p at
// -(p . u) / c after it reaches the origin. Nothing here knows eq. (3).
namespace soundmap::acoustics::testing {

inline constexpr double kSpeedOfSound_mps = 343.0;

using Microphones = std::vector<Eigen::Vector3d>;

Eigen::Vector3d RandomDirection(std::mt19937_64& random);
// At random in a ball.
Microphones RandomArray(int microphones, double radius_m, std::mt19937_64& random);
// Three rings on a dome, 16 microphones, 0.3 m wide.
Microphones DomeArray();

double AngleBetween_deg(const Eigen::Vector3d& a, const Eigen::Vector3d& b);

struct PlaneWave {
  Eigen::Vector3d direction_in_array;
  double rms = 1000.0;  // in steps of the 16-bit samples
};

// Interleaved samples of all waves together, each a noise-like sum of sinusoids between 200 Hz and
// 90 % of half the rate, and noise that is independent at each microphone.
std::vector<std::int16_t> Record(const Microphones& mic_in_array_m, int sample_rate_hz, int samples,
                                 const std::vector<PlaneWave>& waves, double noise_rms,
                                 std::mt19937_64& random);

// The spectra of eq. (1) of one plane wave with random phases per bin and frame.
PhatSpectra WaveSpectra(const FrameLayout& layout, const Microphones& mic_in_array_m,
                        const Eigen::Vector3d& direction_in_array, std::mt19937_64& random);

// Eqs. (2)-(5) as printed, in double precision, for one direction.
double LiteralPower(const FrameLayout& layout, const Microphones& mic_in_array_m,
                    const PhatSpectra& spectra, const Eigen::Vector3d& direction_in_array);

// Eq. (1) by the definition of the Fourier transform, in double precision.
struct LiteralSpectra {
  std::vector<double> real;
  std::vector<double> imaginary;
};
LiteralSpectra LiteralPhat(const FrameLayout& layout, int microphones,
                           const std::vector<std::int16_t>& samples);
double LiteralPower(const FrameLayout& layout, const Microphones& mic_in_array_m,
                    const LiteralSpectra& spectra, const Eigen::Vector3d& direction_in_array);

frames::Calibration CalibrationOf(const Microphones& mic_in_array_m, int sample_rate_hz);

}  // namespace soundmap::acoustics::testing
