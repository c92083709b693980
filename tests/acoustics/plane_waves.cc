#include "tests/acoustics/plane_waves.h"

#include <algorithm>
#include <cmath>
#include <complex>

#include "geometry/angles.h"

namespace soundmap::acoustics::testing {

using geometry::kPi;

Eigen::Vector3d RandomDirection(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  return Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
}

Microphones RandomArray(int microphones, double radius_m, std::mt19937_64& random) {
  std::uniform_real_distribution<double> uniform;
  Microphones mic_in_array_m;
  for (int n = 0; n < microphones; ++n) {
    mic_in_array_m.push_back(RandomDirection(random) * radius_m * std::cbrt(uniform(random)));
  }
  return mic_in_array_m;
}

Microphones DomeArray() {
  Microphones mic_in_array_m;
  const auto ring = [&](int count, double radius_m, double height_m) {
    for (int n = 0; n < count; ++n) {
      const double angle_rad = 2.0 * kPi * n / count + height_m;
      mic_in_array_m.emplace_back(radius_m * std::cos(angle_rad), radius_m * std::sin(angle_rad),
                                  height_m);
    }
  };
  ring(8, 0.15, 0.0);
  ring(5, 0.12, 0.09);
  ring(3, 0.05, 0.14);
  return mic_in_array_m;
}

double AngleBetween_deg(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return geometry::DegFromRad(std::atan2(a.cross(b).norm(), a.dot(b)));
}

std::vector<std::int16_t> Record(const Microphones& mic_in_array_m, int sample_rate_hz, int samples,
                                 const std::vector<PlaneWave>& waves, double noise_rms,
                                 std::mt19937_64& random) {
  const int channels = static_cast<int>(mic_in_array_m.size());
  std::normal_distribution<double> noise;
  std::vector<double> sum(static_cast<std::size_t>(samples) * channels);
  for (double& value : sum) value = noise_rms * noise(random);
  constexpr int kTones = 400;
  for (const PlaneWave& wave : waves) {
    std::uniform_real_distribution<double> frequency_hz(200.0, 0.45 * sample_rate_hz);
    std::uniform_real_distribution<double> phase(0.0, 2.0 * kPi);
    const double amplitude = wave.rms * std::sqrt(2.0 / kTones);
    for (int tone = 0; tone < kTones; ++tone) {
      const double omega = 2.0 * kPi * frequency_hz(random);
      const double start_rad = phase(random);
      const std::complex<double> turn = std::polar(1.0, omega / sample_rate_hz);
      for (int n = 0; n < channels; ++n) {
        const double arrival_s =
            -mic_in_array_m[n].dot(wave.direction_in_array) / kSpeedOfSound_mps;
        std::complex<double> phasor = std::polar(amplitude, start_rad - omega * arrival_s);
        for (int s = 0; s < samples; ++s, phasor *= turn) {
          sum[static_cast<std::size_t>(s) * channels + n] += phasor.real();
        }
      }
    }
  }
  std::vector<std::int16_t> pcm(sum.size());
  std::transform(sum.begin(), sum.end(), pcm.begin(), [](double value) {
    return static_cast<std::int16_t>(std::lround(std::clamp(value, -32768.0, 32767.0)));
  });
  return pcm;
}

PhatSpectra WaveSpectra(const FrameLayout& layout, const Microphones& mic_in_array_m,
                        const Eigen::Vector3d& direction_in_array, std::mt19937_64& random) {
  const int channels = static_cast<int>(mic_in_array_m.size());
  PhatSpectra spectra(layout.frames_per_scan, channels, layout.bins);
  std::uniform_real_distribution<double> phase(0.0, 2.0 * kPi);
  for (int t = 0; t < spectra.frames; ++t) {
    for (int b = 0; b < spectra.bins; ++b) {
      const double start_rad = phase(random);
      for (int n = 0; n < channels; ++n) {
        const double arrival_s = -mic_in_array_m[n].dot(direction_in_array) / kSpeedOfSound_mps;
        const double angle = start_rad - 2.0 * kPi * layout.bin_hz(b) * arrival_s;
        spectra.real[spectra.index(t, n, b)] = static_cast<float>(std::cos(angle));
        spectra.imaginary[spectra.index(t, n, b)] = static_cast<float>(std::sin(angle));
      }
    }
  }
  return spectra;
}

namespace {

template <typename Spectra>
double LiteralPowerOf(const FrameLayout& layout, const Microphones& mic_in_array_m,
                      const Spectra& spectra, int row_bins,
                      const Eigen::Vector3d& direction_in_array) {
  const int channels = static_cast<int>(mic_in_array_m.size());
  double power = 0.0;
  for (int b = 0; b < layout.bins; ++b) {
    std::vector<std::complex<double>> steering;  // eq. (3)
    for (const Eigen::Vector3d& mic_m : mic_in_array_m) {
      const double tau =
          2.0 * kPi * layout.bin_hz(b) * mic_m.dot(direction_in_array) / kSpeedOfSound_mps;
      steering.push_back(std::polar(1.0 / channels, -tau));
    }
    double mean = 0.0;
    for (int t = 0; t < layout.frames_per_scan; ++t) {
      std::complex<double> y = 0.0;  // eq. (2)
      for (int n = 0; n < channels; ++n) {
        const std::size_t i = (static_cast<std::size_t>(t) * channels + n) * row_bins + b;
        y += steering[n] * std::complex<double>(spectra.real[i], spectra.imaginary[i]);
      }
      mean += std::norm(y) / layout.frames_per_scan;  // eq. (4)
    }
    power += mean;  // eq. (5)
  }
  return power;
}

}  // namespace

double LiteralPower(const FrameLayout& layout, const Microphones& mic_in_array_m,
                    const PhatSpectra& spectra, const Eigen::Vector3d& direction_in_array) {
  return LiteralPowerOf(layout, mic_in_array_m, spectra, spectra.width, direction_in_array);
}

double LiteralPower(const FrameLayout& layout, const Microphones& mic_in_array_m,
                    const LiteralSpectra& spectra, const Eigen::Vector3d& direction_in_array) {
  return LiteralPowerOf(layout, mic_in_array_m, spectra, layout.bins, direction_in_array);
}

LiteralSpectra LiteralPhat(const FrameLayout& layout, int microphones,
                           const std::vector<std::int16_t>& samples) {
  const int w_samples = layout.window_samples;
  std::vector<std::complex<double>> turn(w_samples);
  std::vector<double> hann(w_samples);
  for (int s = 0; s < w_samples; ++s) {
    turn[s] = std::polar(1.0, -2.0 * kPi * s / w_samples);
    hann[s] = std::pow(std::sin(kPi * s / w_samples), 2);
  }
  LiteralSpectra spectra;
  for (int t = 0; t < layout.frames_per_scan; ++t) {
    for (int n = 0; n < microphones; ++n) {
      for (int b = 0; b < layout.bins; ++b) {
        const std::int64_t bin = layout.first_bin + b;
        std::complex<double> x = 0.0;
        for (int s = 0; s < w_samples; ++s) {
          const std::size_t at =
              static_cast<std::size_t>(t * layout.hop_samples() + s) * microphones + n;
          x += hann[s] * samples[at] * turn[(bin * s) % w_samples];
        }
        const double magnitude = std::abs(x);
        spectra.real.push_back(magnitude > 0.0 ? x.real() / magnitude : 0.0);
        spectra.imaginary.push_back(magnitude > 0.0 ? x.imag() / magnitude : 0.0);
      }
    }
  }
  return spectra;
}

frames::Calibration CalibrationOf(const Microphones& mic_in_array_m, int sample_rate_hz) {
  frames::Calibration calibration;
  calibration.mic_in_array_m = mic_in_array_m;
  calibration.audio_sample_rate_hz = sample_rate_hz;
  return calibration;
}

}  // namespace soundmap::acoustics::testing
