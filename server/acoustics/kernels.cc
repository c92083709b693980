#include "acoustics/kernels.h"

#include <algorithm>
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

void PlainWeighRows(const WeightedRows& in) { WeighRows<4>(in); }
void PlainCrossSpectra(const CrossSpectra& in) { SumCrossSpectra<4>(in); }

#if defined(__x86_64__)
__attribute__((target("avx2"))) void Avx2WeighRows(const WeightedRows& in) { WeighRows<8>(in); }
__attribute__((target("avx2"))) void Avx2CrossSpectra(const CrossSpectra& in) {
  SumCrossSpectra<8>(in);
}
#endif

}  // namespace

const std::vector<Kernels>& AllKernels() {
  static const std::vector<Kernels>* const kernels = [] {
    auto* all = new std::vector<Kernels>{{"plain", PlainWeighRows, PlainCrossSpectra}};
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
      all->push_back({"avx2", Avx2WeighRows, Avx2CrossSpectra});
    }
#endif
    return all;
  }();
  return *kernels;
}

}  // namespace soundmap::acoustics
