#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace soundmap::acoustics {

// Rows of tables are padded with zeros to a multiple of this many floats.
inline constexpr int kRowFloats = 8;
constexpr int PaddedToRow(int count) { return (count + kRowFloats - 1) / kRowFloats * kRowFloats; }

// sum[j][w] = sum over r of weight[j][r] * row[r][w]; strides and steps are in floats.
struct WeightedRows {
  const float* row = nullptr;
  std::ptrdiff_t row_stride = 0;
  int rows = 0;
  int width = 0;  // a multiple of kRowFloats
  const float* weight = nullptr;
  std::ptrdiff_t weight_stride = 0;  // from one sum to the next
  std::ptrdiff_t weight_step = 1;    // from one row to the next
  int sums = 0;
  float* sum = nullptr;
  std::ptrdiff_t sum_stride = 0;
};

// Where the cross-spectrum of two microphones goes.
struct PairTarget {
  std::int32_t group = 0;
  float sign = 1.0f;  // -1: the group has the conjugate
};

// real[g], imaginary[g] = sum over the pairs (a, b) of group g and over the frames of V_a
// conj(V_b). Spectra are frame by frame, microphone by microphone, in rows of `width` bins.
struct CrossSpectra {
  const float* real = nullptr;
  const float* imaginary = nullptr;
  int frames = 0;
  int microphones = 0;
  int width = 0;                       // a multiple of kRowFloats
  const PairTarget* target = nullptr;  // of a <= b: (0, 0), (0, 1), .. (1, 1), ..
  int groups = 0;
  float* group_real = nullptr;
  float* group_imaginary = nullptr;
};

// One frame of all microphones, two of them in one row of complex numbers: row p has the samples of
// microphones 2 p and 2 p + 1 as real and imaginary parts (0 where there is none), times the
// window.
struct FrameRows {
  const std::int16_t* samples = nullptr;  // interleaved
  int microphones = 0;
  int count = 0;                  // samples of each
  const float* window = nullptr;  // every value twice
  float* row = nullptr;
  std::ptrdiff_t row_stride = 0;  // in floats
  float* energy = nullptr;        // of each row: the sum of all squares
};

// Eq. (1) for the two microphones of a row: from the transform Z of its complex numbers, with Z_W =
// Z_0 behind it, the spectra (Z_b + conj Z_{W-b}) / 2 and (Z_b - conj Z_{W-b}) / 2j, divided by
// their magnitudes. A bin whose power is not above `silent` gives 0.
struct RowPhat {
  const float* transform = nullptr;  // 2 W + 2 floats, and kRowFloats readable ones on either side
  int window_samples = 0;            // W
  int first_bin = 0;
  int bins = 0;
  float silent = 0.0f;
  float* real[2] = {};  // PaddedToRow(bins); null: there is no second microphone
  float* imaginary[2] = {};
};

// The inner loops, for one kind of processor. Every kind gives the same bits: products are rounded
// before they are added, and the order of additions does not depend on the width of the vectors.
struct Kernels {
  const char* name;
  void (*weigh_rows)(const WeightedRows&);
  void (*cross_spectra)(const CrossSpectra&);
  void (*fill_rows)(const FrameRows&);
  void (*phat)(const RowPhat&);
};

// Those that this processor can run, the fastest last.
const std::vector<Kernels>& AllKernels();
inline const Kernels& BestKernels() { return AllKernels().back(); }

}  // namespace soundmap::acoustics
