#include "acoustics/kernels.h"

#include <algorithm>
#include <cmath>
#include <cstring>

// Compiled without fused multiply-add: see Kernels.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // wide vectors are passed to inlined functions only
#endif

#define SOUNDMAP_INLINE inline __attribute__((always_inline))

namespace soundmap::acoustics {
namespace {

template <int lanes>
struct Vector {
  typedef float Type __attribute__((vector_size(lanes * sizeof(float))));
};

template <typename V>
SOUNDMAP_INLINE V Load(const float* p) {
  V value;
  std::memcpy(&value, p, sizeof(value));
  return value;
}
template <typename V>
SOUNDMAP_INLINE void Store(float* p, V value) {
  std::memcpy(p, &value, sizeof(value));
}

// Sums j .. j + count - 1, floats w .. w + vectors * lanes - 1.
template <int lanes, int vectors, int count>
SOUNDMAP_INLINE void WeighBlock(const WeightedRows& in, int j, int w) {
  using V = typename Vector<lanes>::Type;
  V sum[count][vectors] = {};
  const float* row = in.row + w;
  const float* weight = in.weight + j * in.weight_stride;
  for (int r = 0; r < in.rows; ++r, row += in.row_stride, weight += in.weight_step) {
    for (int v = 0; v < vectors; ++v) {
      const V value = Load<V>(row + v * lanes);
      for (int k = 0; k < count; ++k) sum[k][v] += value * weight[k * in.weight_stride];
    }
  }
  for (int k = 0; k < count; ++k) {
    for (int v = 0; v < vectors; ++v) {
      Store(in.sum + (j + k) * in.sum_stride + w + v * lanes, sum[k][v]);
    }
  }
}

template <int lanes, int vectors, int count>
SOUNDMAP_INLINE void WeighColumns(const WeightedRows& in, int j) {
  int w = 0;
  for (; w + vectors * lanes <= in.width; w += vectors * lanes) {
    WeighBlock<lanes, vectors, count>(in, j, w);
  }
  for (; w < in.width; w += kRowFloats) WeighBlock<lanes, kRowFloats / lanes, count>(in, j, w);
}

// Eight accumulators hide the latency of an addition.
template <int lanes>
SOUNDMAP_INLINE void WeighRows(const WeightedRows& in) {
  int j = 0;
  for (; j + 4 <= in.sums; j += 4) WeighColumns<lanes, 2, 4>(in, j);
  for (; j + 2 <= in.sums; j += 2) WeighColumns<lanes, 4, 2>(in, j);
  for (; j < in.sums; ++j) WeighColumns<lanes, 8, 1>(in, j);
}

// Microphones a0 .. a0 + 1 with b0 .. b0 + 1, one vector of bins. Without a second a or b the first
// stands in, and its result is dropped.
template <int lanes>
SOUNDMAP_INLINE void SumCrossSpectra(const CrossSpectra& in) {
  using V = typename Vector<lanes>::Type;
  const int n = in.microphones;
  const std::ptrdiff_t frame = static_cast<std::ptrdiff_t>(n) * in.width;
  std::fill_n(in.group_real, static_cast<std::size_t>(in.groups) * in.width, 0.0f);
  std::fill_n(in.group_imaginary, static_cast<std::size_t>(in.groups) * in.width, 0.0f);
  for (int w = 0; w < in.width; w += lanes) {
    for (int a0 = 0; a0 < n; a0 += 2) {
      for (int b0 = a0; b0 < n; b0 += 2) {
        const int a[2] = {a0, std::min(a0 + 1, n - 1)};
        const int b[2] = {b0, std::min(b0 + 1, n - 1)};
        V real[2][2] = {};
        V imaginary[2][2] = {};
        for (int t = 0; t < in.frames; ++t) {
          const float* from_real = in.real + t * frame + w;
          const float* from_imaginary = in.imaginary + t * frame + w;
          V a_real[2];
          V a_imaginary[2];
          for (int i = 0; i < 2; ++i) {
            a_real[i] = Load<V>(from_real + static_cast<std::ptrdiff_t>(a[i]) * in.width);
            a_imaginary[i] = Load<V>(from_imaginary + static_cast<std::ptrdiff_t>(a[i]) * in.width);
          }
          for (int k = 0; k < 2; ++k) {
            const V b_real = Load<V>(from_real + static_cast<std::ptrdiff_t>(b[k]) * in.width);
            const V b_imaginary =
                Load<V>(from_imaginary + static_cast<std::ptrdiff_t>(b[k]) * in.width);
            for (int i = 0; i < 2; ++i) {
              real[i][k] += a_real[i] * b_real;
              real[i][k] += a_imaginary[i] * b_imaginary;
              imaginary[i][k] += a_imaginary[i] * b_real;
              imaginary[i][k] -= a_real[i] * b_imaginary;
            }
          }
        }
        for (int i = 0; i < 2; ++i) {
          for (int k = 0; k < 2; ++k) {
            const int first = a0 + i;
            const int second = b0 + k;
            if (first > second || second >= n) continue;
            const PairTarget& target = in.target[first * (2 * n - first + 1) / 2 + second - first];
            const std::ptrdiff_t to = static_cast<std::ptrdiff_t>(target.group) * in.width + w;
            Store(in.group_real + to, Load<V>(in.group_real + to) + real[i][k]);
            Store(in.group_imaginary + to,
                  Load<V>(in.group_imaginary + to) + imaginary[i][k] * target.sign);
          }
        }
      }
    }
  }
}

typedef float Float8 __attribute__((vector_size(32)));
typedef std::int16_t Short8 __attribute__((vector_size(16)));
typedef std::int32_t Int4 __attribute__((vector_size(16)));

// Rows p .. p + 3, samples s .. s + 3.
SOUNDMAP_INLINE void FillFourRows(const FrameRows& in, int p, int s, Float8 energy[4]) {
  Int4 both[4];  // by sample: four pairs of 16-bit values
  for (int i = 0; i < 4; ++i) {
    std::memcpy(&both[i], in.samples + static_cast<std::ptrdiff_t>(s + i) * in.microphones + 2 * p,
                16);
  }
  const Int4 low01 = __builtin_shufflevector(both[0], both[1], 0, 4, 1, 5);
  const Int4 high01 = __builtin_shufflevector(both[0], both[1], 2, 6, 3, 7);
  const Int4 low23 = __builtin_shufflevector(both[2], both[3], 0, 4, 1, 5);
  const Int4 high23 = __builtin_shufflevector(both[2], both[3], 2, 6, 3, 7);
  const Int4 row[4] = {__builtin_shufflevector(low01, low23, 0, 1, 4, 5),
                       __builtin_shufflevector(low01, low23, 2, 3, 6, 7),
                       __builtin_shufflevector(high01, high23, 0, 1, 4, 5),
                       __builtin_shufflevector(high01, high23, 2, 3, 6, 7)};
  const Float8 window = Load<Float8>(in.window + 2 * s);
  for (int i = 0; i < 4; ++i) {
    Short8 values;
    std::memcpy(&values, &row[i], sizeof(values));
    const Float8 windowed = __builtin_convertvector(values, Float8) * window;
    Store(in.row + (p + i) * in.row_stride + 2 * s, windowed);
    energy[i] += windowed * windowed;
  }
}

// One row from sample s on, as FillFourRows would.
SOUNDMAP_INLINE void FillRow(const FrameRows& in, int p, int s, Float8& energy) {
  for (; s < in.count; ++s) {
    for (int part = 0; part < 2; ++part) {
      const int n = 2 * p + part;
      const float value =
          n < in.microphones
              ? static_cast<float>(in.samples[static_cast<std::ptrdiff_t>(s) * in.microphones + n])
              : 0.0f;
      const float windowed = value * in.window[2 * s];
      in.row[p * in.row_stride + 2 * s + part] = windowed;
      energy[(2 * s + part) % 8] += windowed * windowed;
    }
  }
}

SOUNDMAP_INLINE float Total(Float8 v) {
  return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]));
}

SOUNDMAP_INLINE void FillRows(const FrameRows& in) {
  const int rows = (in.microphones + 1) / 2;
  int p = 0;
  for (; 2 * (p + 4) <= in.microphones; p += 4) {
    Float8 energy[4] = {};
    int s = 0;
    for (; s + 4 <= in.count; s += 4) FillFourRows(in, p, s, energy);
    for (int i = 0; i < 4; ++i) {
      FillRow(in, p + i, s, energy[i]);
      in.energy[p + i] = Total(energy[i]);
    }
  }
  for (; p < rows; ++p) {
    Float8 energy = {};
    FillRow(in, p, 0, energy);
    in.energy[p] = Total(energy);
  }
}

// real, imaginary <- real, imaginary / magnitude.
SOUNDMAP_INLINE void Normalize(float* __restrict real, float* __restrict imaginary, int count,
                               float silent) {
  for (int i = 0; i < count; ++i) {
    const float power = real[i] * real[i] + imaginary[i] * imaginary[i];
    const float scale = power > silent ? 1.0f / std::sqrt(power) : 0.0f;
    real[i] *= scale;
    imaginary[i] *= scale;
  }
}

SOUNDMAP_INLINE void Phat(const RowPhat& in) {
  const float* up = in.transform + 2 * in.first_bin;
  const float* down = in.transform + 2 * (in.window_samples - in.first_bin);
  for (int b = 0; b < in.bins; b += 4) {
    // Four complex numbers each; the second four in falling order.
    const Float8 z = Load<Float8>(up + 2 * b);
    const Float8 mirrored = Load<Float8>(down - 2 * b - 6);
    const Float8 of_w_less_b = __builtin_shufflevector(mirrored, mirrored, 6, 7, 4, 5, 2, 3, 0, 1);
    const Float8 sum = z + of_w_less_b;
    const Float8 difference = z - of_w_less_b;
    // Twice the spectra: Re Z + Re Z', Im Z - Im Z'; Im Z + Im Z', Re Z' - Re Z.
    typedef float Float4 __attribute__((vector_size(16)));
    Store<Float4>(in.real[0] + b, __builtin_shufflevector(sum, sum, 0, 2, 4, 6));
    Store<Float4>(in.imaginary[0] + b, __builtin_shufflevector(difference, difference, 1, 3, 5, 7));
    if (in.real[1] == nullptr) continue;
    Store<Float4>(in.real[1] + b, __builtin_shufflevector(sum, sum, 1, 3, 5, 7));
    Store<Float4>(in.imaginary[1] + b,
                  -__builtin_shufflevector(difference, difference, 0, 2, 4, 6));
  }
  for (int part = 0; part < 2 && in.real[part] != nullptr; ++part) {
    Normalize(in.real[part], in.imaginary[part], PaddedToRow(in.bins), 4.0f * in.silent);
    for (int b = in.bins; b < PaddedToRow(in.bins); ++b) {
      in.real[part][b] = in.imaginary[part][b] = 0.0f;
    }
  }
}

void PlainWeighRows(const WeightedRows& in) { WeighRows<4>(in); }
void PlainCrossSpectra(const CrossSpectra& in) { SumCrossSpectra<4>(in); }
void PlainFillRows(const FrameRows& in) { FillRows(in); }
void PlainPhat(const RowPhat& in) { Phat(in); }

#if defined(__x86_64__)
__attribute__((target("avx2"))) void Avx2WeighRows(const WeightedRows& in) { WeighRows<8>(in); }
__attribute__((target("avx2"))) void Avx2CrossSpectra(const CrossSpectra& in) {
  SumCrossSpectra<8>(in);
}
__attribute__((target("avx2"))) void Avx2FillRows(const FrameRows& in) { FillRows(in); }
__attribute__((target("avx2"))) void Avx2Phat(const RowPhat& in) { Phat(in); }
#endif

}  // namespace

const std::vector<Kernels>& AllKernels() {
  static const std::vector<Kernels>* const kernels = [] {
    auto* all = new std::vector<Kernels>{
        {"plain", PlainWeighRows, PlainCrossSpectra, PlainFillRows, PlainPhat}};
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
      all->push_back({"avx2", Avx2WeighRows, Avx2CrossSpectra, Avx2FillRows, Avx2Phat});
    }
#endif
    return all;
  }();
  return *kernels;
}

}  // namespace soundmap::acoustics
