#include "acoustics/peak_level.h"

#include <Eigen/LU>
#include <algorithm>
#include <bit>
#include <cmath>
#include <complex>

#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

// Above this the beams of two peaks are one.
constexpr float kMaxOverlap = 0.5f;
constexpr int kMaxMicrophones = 64;

// One value a microphone, for the compiler's vector instructions.
struct Row {
  alignas(16) float real[kMaxMicrophones];
  alignas(16) float imaginary[kMaxMicrophones];
};

// a *= b
void Multiply(Row& a, const Row& b, int count) {
  for (int m = 0; m < count; ++m) {
    const float real = a.real[m] * b.real[m] - a.imaginary[m] * b.imaginary[m];
    a.imaginary[m] = a.real[m] * b.imaginary[m] + a.imaginary[m] * b.real[m];
    a.real[m] = real;
  }
}

// |sum_m conj(a_m) b_m|^2 / count^2
float Coherence(const Row& a, const Row& b, int count) {
  float real = 0.0f;
  float imaginary = 0.0f;
  for (int m = 0; m < count; ++m) {
    real += a.real[m] * b.real[m] + a.imaginary[m] * b.imaginary[m];
    imaginary += a.real[m] * b.imaginary[m] - a.imaginary[m] * b.real[m];
  }
  return (real * real + imaginary * imaginary) / static_cast<float>(count * count);
}

}  // namespace

PeakLevel::PeakLevel(const FrameLayout& layout, double speed_of_sound_mps,
                     const std::vector<Eigen::Vector3d>& mic_in_array_m)
    : bands_(frames::OctaveBandsAt(layout.sample_rate_hz)),
      microphones_(static_cast<int>(mic_in_array_m.size())),
      window_samples_(layout.window_samples),
      bin_rad_per_m_(2.0 * geometry::kPi * layout.sample_rate_hz / layout.window_samples /
                     speed_of_sound_mps),
      mic_in_array_m_(mic_in_array_m) {
  const double bin_hz = static_cast<double>(layout.sample_rate_hz) / layout.window_samples;
  for (int band = 0; band <= bands_; ++band) {
    first_bin_of_band_[band] =
        std::max(1, static_cast<int>(std::ceil(frames::OctaveBegin_hz(band) / bin_hz)));
  }
  const auto stride = [](int bin) { return static_cast<int>(std::bit_floor(bin / 8u | 1u)); };
  for (int bin = 1, band = 0; band < bands_; bin += stride(bin)) {
    while (band < bands_ && bin >= first_bin_of_band_[band + 1]) ++band;
    if (band < bands_ && bin >= first_bin_of_band_[band]) bins_.push_back({bin, band});
  }
}

std::vector<frames::BandPowers> PeakLevel::Levels(const FrameSpectra& frame,
                                                  std::span<const Peak> peaks) const {
  const int count = std::min<int>(static_cast<int>(peaks.size()), kMaxPeaks);
  std::vector<frames::BandPowers> levels(count, frames::BandPowers{});
  if (count == 0) return levels;

  // All bins of a band: |X_a|^2 + |X_b|^2 of two microphones in one transform is half the sum of
  // the squares at k and -k.
  std::array<float, frames::kOctaveBands> band_power{};
  for (int band = 0; band < bands_; ++band) {
    float sum = 0.0f;
    for (int p = 0; 2 * p < microphones_; ++p) {
      const float* row = frame.row(p);
      for (int k = first_bin_of_band_[band]; k < first_bin_of_band_[band + 1]; ++k) {
        const float* plus = row + 2 * k;
        const float* minus = row + 2 * (window_samples_ - k);
        sum += plus[0] * plus[0] + plus[1] * plus[1] + minus[0] * minus[0] + minus[1] * minus[1];
      }
    }
    // One-sided, over the energy of the Hann window, 3 W / 8, in steps of the 16-bit samples.
    const double w = window_samples_;
    band_power[band] = static_cast<float>(0.5 * sum / microphones_ * 2.0 / (w * w * 3.0 / 8.0) /
                                          (32768.0 * 32768.0));
  }

  const auto unit_row = [&](const Eigen::Vector3d& direction) {
    Row row;
    for (int m = 0; m < microphones_; ++m) {
      const double phase = bin_rad_per_m_ * mic_in_array_m_[m].dot(direction);
      row.real[m] = static_cast<float>(std::cos(phase));
      row.imaginary[m] = static_cast<float>(std::sin(phase));
    }
    return row;
  };
  // Of each peak: the wave at the bin at hand, and at the present stride.
  struct Wave {
    Row at;
    Row step;
  };
  std::vector<Wave> waves(count);
  for (int i = 0; i < count; ++i) {
    waves[i].step = unit_row(peaks[i].direction_in_array);
    waves[i].at = waves[i].step;
  }
  struct Sums {
    int bins = 0;
    float power = 0.0f;                        // of the microphones' mean
    float beam[kMaxPeaks] = {};                // b_i
    float overlap[kMaxPeaks][kMaxPeaks] = {};  // G_ij
  };
  std::array<Sums, frames::kOctaveBands> sums;
  int bin = 1;
  int stride = 1;
  for (const Bin& next : bins_) {
    while (bin < next.bin) {
      const int wanted = static_cast<int>(std::bit_floor(bin / 8u | 1u));
      for (; stride < wanted; stride *= 2) {
        for (Wave& wave : waves) Multiply(wave.step, Row(wave.step), microphones_);
      }
      for (Wave& wave : waves) Multiply(wave.at, wave.step, microphones_);
      bin += stride;
    }
    Row sound;
    Sums& sum = sums[next.band];
    for (int p = 0; 2 * p < microphones_; ++p) {
      const float* plus = frame.row(p) + 2 * bin;
      const float* minus = frame.row(p) + 2 * (window_samples_ - bin);
      sound.real[2 * p] = 0.5f * (plus[0] + minus[0]);
      sound.imaginary[2 * p] = 0.5f * (plus[1] - minus[1]);
      if (2 * p + 1 == microphones_) break;
      sound.real[2 * p + 1] = 0.5f * (plus[1] + minus[1]);
      sound.imaginary[2 * p + 1] = 0.5f * (minus[0] - plus[0]);
    }
    float power = 0.0f;
    for (int m = 0; m < microphones_; ++m) {
      power += sound.real[m] * sound.real[m] + sound.imaginary[m] * sound.imaginary[m];
    }
    ++sum.bins;
    sum.power += power / static_cast<float>(microphones_);
    for (int i = 0; i < count; ++i) {
      sum.beam[i] += Coherence(waves[i].at, sound, microphones_);
      for (int j = 0; j < i; ++j) {
        sum.overlap[i][j] += Coherence(waves[i].at, waves[j].at, microphones_);
      }
    }
  }

  for (int band = 0; band < bands_; ++band) {
    const Sums& sum = sums[band];
    if (sum.bins == 0 || !(sum.power > 0.0f)) continue;
    using Matrix =
        Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxPeaks + 1, kMaxPeaks + 1>;
    using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxPeaks + 1, 1>;
    Matrix beam = Matrix::Ones(count + 1, count + 1);
    Vector power(count + 1);
    bool separable = true;
    for (int i = 0; i < count; ++i) {
      beam(i, count) = 1.0 / microphones_;
      power[i] = sum.beam[i] / sum.power;
      for (int j = 0; j < i; ++j) {
        beam(i, j) = beam(j, i) = sum.overlap[i][j] / static_cast<float>(sum.bins);
        separable = separable && beam(i, j) < kMaxOverlap;
      }
    }
    power[count] = 1.0;
    if (separable) {
      const Vector share = beam.partialPivLu().solve(power);
      for (int i = 0; i < count; ++i) {
        levels[i][band] = band_power[band] * static_cast<float>(share[i]);
      }
    } else {
      double total = 0.0;
      double coherent = 0.0;
      for (int i = 0; i < count; ++i) {
        total += peaks[i].power;
        coherent = std::max(coherent, power[i]);
      }
      for (int i = 0; i < count; ++i) {
        levels[i][band] = band_power[band] * static_cast<float>(coherent * peaks[i].power / total);
      }
    }
  }
  return levels;
}

}  // namespace soundmap::acoustics
