#include "acoustics/stft.h"

#include <fftw3.h>

#include <cmath>
#include <mutex>

#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

// FFTW's planner keeps global state; executing a plan does not.
std::mutex planner_mutex;

// Relative to the energy of the windowed frame: a few times the rounding error of a float
// transform.
constexpr float kRoundingLevel = 3e-7f;

float Energy(const float* values, int count) {
  constexpr int kLanes = 8;  // a fixed order that vectorizes
  float lane[kLanes] = {};
  int i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    for (int k = 0; k < kLanes; ++k) lane[k] += values[i + k] * values[i + k];
  }
  float sum = 0.0f;
  for (; i < count; ++i) sum += values[i] * values[i];
  for (int k = 0; k < kLanes; ++k) sum += lane[k];
  return sum;
}

}  // namespace

struct Stft::Transform {
  Transform(int window_samples, int microphones)
      : window(window_samples),
        input(fftwf_alloc_real(static_cast<std::size_t>(window_samples) * microphones)),
        output(
            fftwf_alloc_complex(static_cast<std::size_t>(window_samples / 2 + 1) * microphones)) {
    for (int s = 0; s < window_samples; ++s) {
      window[s] =
          static_cast<float>(0.5 - 0.5 * std::cos(2.0 * geometry::kPi * s / window_samples));
    }
    const std::lock_guard lock(planner_mutex);
    // FFTW_ESTIMATE: the plan does not depend on timing, so equal input gives equal bits.
    plan =
        fftwf_plan_many_dft_r2c(1, &window_samples, microphones, input, nullptr, 1, window_samples,
                                output, nullptr, 1, window_samples / 2 + 1, FFTW_ESTIMATE);
  }
  ~Transform() {
    {
      const std::lock_guard lock(planner_mutex);
      fftwf_destroy_plan(plan);
    }
    fftwf_free(input);
    fftwf_free(output);
  }
  Transform(const Transform&) = delete;
  Transform& operator=(const Transform&) = delete;

  std::vector<float> window;
  float* input;           // microphone by microphone
  fftwf_complex* output;  // W/2 + 1 bins, microphone by microphone
  fftwf_plan plan;
};

Stft::Stft(const FrameLayout& layout, int microphones)
    : layout_(layout),
      microphones_(microphones),
      transform_(std::make_unique<Transform>(layout.window_samples, microphones)) {}
Stft::~Stft() = default;
Stft::Stft(Stft&&) noexcept = default;
Stft& Stft::operator=(Stft&&) noexcept = default;

PhatSpectra Stft::Analyze(std::span<const std::int16_t> samples) {
  const int window_samples = layout_.window_samples;
  const int spectrum_bins = window_samples / 2 + 1;
  PhatSpectra spectra(layout_.frames_per_scan, microphones_, layout_.bins);
  for (int t = 0; t < layout_.frames_per_scan; ++t) {
    const std::int16_t* frame =
        samples.data() + static_cast<std::size_t>(t) * layout_.hop_samples() * microphones_;
    for (int n = 0; n < microphones_; ++n) {
      float* input = transform_->input + static_cast<std::size_t>(n) * window_samples;
      for (int s = 0; s < window_samples; ++s) {
        input[s] = transform_->window[s] * frame[static_cast<std::size_t>(s) * microphones_ + n];
      }
    }
    // A real-to-complex transform out of place leaves its input as it is.
    fftwf_execute(transform_->plan);
    for (int n = 0; n < microphones_; ++n) {
      const float* input = transform_->input + static_cast<std::size_t>(n) * window_samples;
      const float silent = kRoundingLevel * kRoundingLevel * Energy(input, window_samples);
      const fftwf_complex* x =
          transform_->output + static_cast<std::size_t>(n) * spectrum_bins + layout_.first_bin;
      float* real = &spectra.real[spectra.index(t, n)];
      float* imaginary = &spectra.imaginary[spectra.index(t, n)];
      for (int b = 0; b < layout_.bins; ++b) {
        const float squared = x[b][0] * x[b][0] + x[b][1] * x[b][1];
        const float scale = squared > silent ? 1.0f / std::sqrt(squared) : 0.0f;
        real[b] = x[b][0] * scale;
        imaginary[b] = x[b][1] * scale;
      }
    }
  }
  return spectra;
}

}  // namespace soundmap::acoustics
