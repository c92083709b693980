#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/kernels.h"

namespace soundmap::acoustics {

// V_n(f, t) of eq. (1) in the band, for the K frames of one audio scan. Each value has magnitude 1,
// or 0 where the bin is silent.
struct PhatSpectra {
  PhatSpectra(int frames, int microphones, int bins)
      : frames(frames),
        microphones(microphones),
        bins(bins),
        width(PaddedToRow(bins)),
        real(static_cast<std::size_t>(frames) * microphones * width),
        imaginary(real.size()) {}

  std::size_t index(int frame, int microphone, int bin = 0) const {
    return (static_cast<std::size_t>(frame) * microphones + microphone) * width + bin;
  }

  int frames;
  int microphones;
  int bins;
  int width;  // of a row of bins; the last ones are 0
  std::vector<float> real;
  std::vector<float> imaginary;
};

// The transforms of one windowed frame as they leave the FFT, in steps of the 16-bit samples: two
// microphones a row, 2 p as the real and 2 p + 1 as the imaginary part of the signal.
struct FrameSpectra {
  const float* first_row = nullptr;  // real and imaginary parts of the bins 0 .. W
  std::ptrdiff_t row_stride = 0;

  const float* row(int p) const { return first_row + p * row_stride; }
};

// The short time Fourier transform with a periodic Hann window, W/2 hop, and the phase transform of
// eq. (1). One thread at a time.
class Stft {
 public:
  Stft(const FrameLayout& layout, int microphones);
  ~Stft();
  Stft(Stft&&) noexcept;
  Stft& operator=(Stft&&) noexcept;

  // `samples`: interleaved, layout.scan_samples() of every microphone.
  // Deviation from eq. (1): a bin of magnitude 0, or so small beside its frame that float
  // arithmetic leaves only rounding there, gives 0.
  // The result holds until the next call. `frame_done` gets each frame's transforms as they are,
  // which hold until it returns.
  const PhatSpectra& Analyze(
      std::span<const std::int16_t> samples,
      const std::function<void(int frame, const FrameSpectra&)>& frame_done = {});

  // The newest frame of what was analyzed last; holds until the next call.
  FrameSpectra newest_frame() const;

 private:
  struct Transform;
  FrameLayout layout_;
  int microphones_;
  PhatSpectra spectra_;
  std::unique_ptr<Transform> transform_;
};

}  // namespace soundmap::acoustics
