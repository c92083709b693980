#include "acoustics/peak_ripple.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>

#include "acoustics/kernels.h"
#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

constexpr double kFirst_hz = 100.0;
constexpr double kLast_hz = 2000.0;
constexpr double kAround_hz = 250.0;
constexpr int kLeastBins = 16;
constexpr double kMostNepers = 3.0;  // that one bin counts

}  // namespace

PeakRipple::PeakRipple(const FrameLayout& layout, double speed_of_sound_mps,
                       const std::vector<Eigen::Vector3d>& mic_in_array_m)
    : microphones_(static_cast<int>(mic_in_array_m.size())),
      frames_(layout.frames_per_scan),
      frame_floats_(PaddedToRow(layout.frames_per_scan)),
      window_samples_(layout.window_samples),
      mic_in_array_m_(mic_in_array_m) {
  const double bin_hz = static_cast<double>(layout.sample_rate_hz) / layout.window_samples;
  bin_waves_per_m_ = bin_hz / speed_of_sound_mps;
  first_ = static_cast<int>(std::ceil(kFirst_hz / bin_hz));
  last_ = std::min(static_cast<int>(kLast_hz / bin_hz), layout.window_samples / 2 - 1);
  around_ = static_cast<int>(std::lround(kAround_hz / bin_hz));
  if (last_ - first_ + 1 < kLeastBins || around_ < 2) last_ = first_ - 1;
  last_kept_ = std::min(last_ + around_, layout.window_samples / 2 - 1);
}

// By bin and microphone the real parts of all frames, then the imaginary ones: beams of all frames
// are formed at once.
void PeakRipple::Keep(int frame, const FrameSpectra& spectra, Frames& frames) const {
  if (last_ < first_) return;
  const std::size_t bin_floats = std::size_t{2} * microphones_ * frame_floats_;
  frames.resize(last_kept_ * bin_floats, 0.0f);
  for (int bin = 1; bin <= last_kept_; ++bin) {
    float* at = frames.data() + (bin - 1) * bin_floats + frame;
    for (int m = 0; m < microphones_; ++m, at += 2 * frame_floats_) {
      const float* plus = spectra.row(m / 2) + 2 * bin;
      const float* minus = spectra.row(m / 2) + 2 * (window_samples_ - bin);
      at[0] = 0.5f * (m % 2 == 0 ? plus[0] + minus[0] : plus[1] + minus[1]);
      at[frame_floats_] = 0.5f * (m % 2 == 0 ? plus[1] - minus[1] : minus[0] - plus[0]);
    }
  }
}

std::vector<frames::EchoRipple> PeakRipple::Ripples(const Frames& frames,
                                                    std::span<const Peak> peaks) const {
  std::vector<frames::EchoRipple> ripples(std::min<std::size_t>(peaks.size(), kMaxPeaks));
  if (last_ < first_) return ripples;
  std::vector<double> log_power(last_kept_ + 1);
  std::vector<float> real(frame_floats_), imaginary(frame_floats_);
  std::vector<std::complex<float>> wave(microphones_), step(microphones_);
  for (std::size_t i = 0; i < ripples.size(); ++i) {
    for (int m = 0; m < microphones_; ++m) {
      const double waves = bin_waves_per_m_ * mic_in_array_m_[m].dot(peaks[i].direction_in_array);
      step[m] = std::complex<float>(std::polar(1.0, 2.0 * geometry::kPi * waves));
    }
    wave = step;
    const float* at = frames.data();
    for (int bin = 1; bin <= last_kept_; ++bin) {
      std::fill(real.begin(), real.end(), 0.0f);
      std::fill(imaginary.begin(), imaginary.end(), 0.0f);
      for (int m = 0; m < microphones_; ++m, at += 2 * frame_floats_) {
        const float c = wave[m].real(), s = wave[m].imag();
        const float* x = at;
        const float* y = at + frame_floats_;
        for (int f = 0; f < frame_floats_; ++f) {
          real[f] += c * x[f] + s * y[f];
          imaginary[f] += c * y[f] - s * x[f];
        }
        wave[m] = {c * step[m].real() - s * step[m].imag(),
                   c * step[m].imag() + s * step[m].real()};
      }
      double power = 0.0;
      for (int f = 0; f < frames_; ++f) power += real[f] * real[f] + imaginary[f] * imaginary[f];
      log_power[bin] = std::log(power);
    }
    std::vector<double> off(last_ - first_ + 1);
    double mean = 0.0;
    for (int bin = first_; bin <= last_; ++bin) {
      const int begin = std::max(bin - around_, 1), end = std::min(bin + around_, last_kept_) + 1;
      double sum = 0.0;
      for (int b = begin; b < end; ++b) sum += log_power[b];
      off[bin - first_] =
          std::clamp(log_power[bin] - sum / (end - begin), -kMostNepers, kMostNepers);
      mean += off[bin - first_] / static_cast<double>(off.size());
    }
    double square = 0.0;
    for (double& value : off) {
      value -= mean;
      square += value * value / static_cast<double>(off.size());
    }
    if (!(square > 0.0)) continue;  // a bin is silent, and its logarithm no number
    ripples[i].waves_per_m = bin_waves_per_m_;
    ripples[i].first_bin = first_;
    for (const double value : off) {
      const double scaled = value / std::sqrt(square) * frames::EchoRipple::kValuesPerSigma;
      ripples[i].values.push_back(
          static_cast<std::int8_t>(std::lround(std::clamp(scaled, -127.0, 127.0))));
    }
  }
  return ripples;
}

}  // namespace soundmap::acoustics
