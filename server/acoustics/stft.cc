#include "acoustics/stft.h"

#include <fftw3.h>

#include <algorithm>
#include <cmath>
#include <mutex>

#include "acoustics/flush_denormals.h"
#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

// FFTW's planner keeps global state; executing a plan does not.
std::mutex planner_mutex;

// Relative to the energy of the two windowed frames that are transformed together: a few times the
// rounding error of a float transform.
constexpr float kRoundingLevel = 3e-7f;

}  // namespace

struct Stft::Transform {
  Transform(int window_samples, int microphones)
      : rows((microphones + 1) / 2),
        input_stride(PaddedToRow(2 * window_samples)),
        output_stride(PaddedToRow(2 * window_samples + 2) + kRowFloats),
        window(2 * static_cast<std::size_t>(window_samples)),
        energy(rows),
        input(fftwf_alloc_real(rows * input_stride)),
        output(fftwf_alloc_real(kRowFloats + rows * output_stride)) {
    std::fill_n(input, rows * input_stride, 0.0f);
    std::fill_n(output, kRowFloats + rows * output_stride, 0.0f);
    for (int s = 0; s < window_samples; ++s) {
      window[2 * s] = window[2 * s + 1] =
          static_cast<float>(0.5 - 0.5 * std::cos(2.0 * geometry::kPi * s / window_samples));
    }
    const std::lock_guard lock(planner_mutex);
    // FFTW_ESTIMATE: the plan does not depend on timing, so equal input gives equal bits, also
    // after a restart.
    plan = fftwf_plan_many_dft(
        1, &window_samples, static_cast<int>(rows), reinterpret_cast<fftwf_complex*>(input),
        nullptr, 1, static_cast<int>(input_stride / 2),
        reinterpret_cast<fftwf_complex*>(output + kRowFloats), nullptr, 1,
        static_cast<int>(output_stride / 2), FFTW_FORWARD, FFTW_ESTIMATE | FFTW_PRESERVE_INPUT);
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

  float* output_row(int p) { return output + kRowFloats + p * output_stride; }

  std::size_t rows;
  std::size_t input_stride;  // in floats
  std::size_t output_stride;
  std::vector<float> window;  // every value twice
  std::vector<float> energy;
  float* input;   // two microphones a row, as real and imaginary parts
  float* output;  // with room to read beyond the ends
  fftwf_plan plan;
};

Stft::Stft(const FrameLayout& layout, int microphones)
    : layout_(layout),
      microphones_(microphones),
      spectra_(layout.frames_per_scan, microphones, layout.bins),
      transform_(std::make_unique<Transform>(layout.window_samples, microphones)) {}
Stft::~Stft() = default;
Stft::Stft(Stft&&) noexcept = default;
Stft& Stft::operator=(Stft&&) noexcept = default;

FrameSpectra Stft::newest_frame() const {
  return {transform_->output_row(0), static_cast<std::ptrdiff_t>(transform_->output_stride)};
}

const PhatSpectra& Stft::Analyze(
    std::span<const std::int16_t> samples,
    const std::function<void(int frame, const FrameSpectra&)>& frame_done) {
  const FlushDenormals flush;
  const Kernels& kernels = BestKernels();
  const int window_samples = layout_.window_samples;
  FrameRows fill;
  fill.microphones = microphones_;
  fill.count = window_samples;
  fill.window = transform_->window.data();
  fill.row = transform_->input;
  fill.row_stride = static_cast<std::ptrdiff_t>(transform_->input_stride);
  fill.energy = transform_->energy.data();
  for (int t = 0; t < layout_.frames_per_scan; ++t) {
    fill.samples =
        samples.data() + static_cast<std::size_t>(t) * layout_.hop_samples() * microphones_;
    kernels.fill_rows(fill);
    fftwf_execute(transform_->plan);
    for (int p = 0; 2 * p < microphones_; ++p) {
      float* transform = transform_->output_row(p);
      transform[2 * window_samples] = transform[0];
      transform[2 * window_samples + 1] = transform[1];
      RowPhat phat;
      phat.transform = transform;
      phat.window_samples = window_samples;
      phat.first_bin = layout_.first_bin;
      phat.bins = layout_.bins;
      phat.silent = kRoundingLevel * kRoundingLevel * transform_->energy[p];
      for (int part = 0; part < 2 && 2 * p + part < microphones_; ++part) {
        phat.real[part] = &spectra_.real[spectra_.index(t, 2 * p + part)];
        phat.imaginary[part] = &spectra_.imaginary[spectra_.index(t, 2 * p + part)];
      }
      kernels.phat(phat);
    }
    if (frame_done) frame_done(t, newest_frame());
  }
  return spectra_;
}

}  // namespace soundmap::acoustics
