#include "acoustics/kernels.h"

#include <gtest/gtest.h>

#include <random>

namespace soundmap::acoustics {
namespace {

std::vector<float> Noise(std::size_t count, std::mt19937_64& random) {
  std::normal_distribution<float> normal;
  std::vector<float> noise(count);
  for (float& value : noise) value = normal(random);
  return noise;
}

struct Sums {
  std::vector<float> sum;
  std::vector<float> real;
  std::vector<float> imaginary;
};

TEST(Kernels, WeightedRowsAreTheSumsTheySayOnEveryProcessor) {
  std::mt19937_64 random(1);
  for (const int width : {8, 24, 56, 64, 136}) {
    for (const int sums : {1, 2, 3, 7}) {
      const int rows = 1 + static_cast<int>(random() % 60);
      const int row_stride = width + 8;
      const int step = 3;
      const int weight_stride = step * rows + 5;
      const int sum_stride = width + 1;
      const std::vector<float> row = Noise(static_cast<std::size_t>(rows) * row_stride, random);
      const std::vector<float> weight =
          Noise(static_cast<std::size_t>(sums) * weight_stride, random);
      std::vector<float> first;
      for (const Kernels& kernels : AllKernels()) {
        std::vector<float> sum(static_cast<std::size_t>(sums) * sum_stride, -1.0f);
        kernels.weigh_rows({row.data(), row_stride, rows, width, weight.data(), weight_stride, step,
                            sums, sum.data(), sum_stride});
        for (int j = 0; j < sums; ++j) {
          for (int w = 0; w < width; ++w) {
            double expected = 0.0;
            for (int r = 0; r < rows; ++r) {
              expected += static_cast<double>(weight[j * weight_stride + r * step]) *
                          row[static_cast<std::size_t>(r) * row_stride + w];
            }
            ASSERT_NEAR(sum[j * sum_stride + w], expected, 1e-4) << kernels.name;
          }
          ASSERT_EQ(sum[j * sum_stride + width], -1.0f);  // nothing is written beyond
        }
        if (first.empty()) first = sum;
        EXPECT_EQ(sum, first) << kernels.name;
      }
    }
  }
}

TEST(Kernels, CrossSpectraAreTheSumsTheySayOnEveryProcessor) {
  std::mt19937_64 random(2);
  for (const int microphones : {2, 3, 4, 7, 16}) {
    constexpr int kFrames = 3;
    constexpr int kWidth = 24;
    constexpr int kGroups = 5;
    const std::size_t values = static_cast<std::size_t>(kFrames) * microphones * kWidth;
    const std::vector<float> real = Noise(values, random);
    const std::vector<float> imaginary = Noise(values, random);
    std::vector<PairTarget> target;
    std::vector<double> expected_real(kGroups * kWidth);
    std::vector<double> expected_imaginary(kGroups * kWidth);
    for (int a = 0; a < microphones; ++a) {
      for (int b = a; b < microphones; ++b) {
        target.push_back({static_cast<int>(random() % kGroups), random() % 2 ? 1.0f : -1.0f});
        for (int t = 0; t < kFrames; ++t) {
          for (int w = 0; w < kWidth; ++w) {
            const int i = (t * microphones + a) * kWidth + w;
            const int j = (t * microphones + b) * kWidth + w;
            const int to = target.back().group * kWidth + w;
            expected_real[to] += static_cast<double>(real[i]) * real[j] +
                                 static_cast<double>(imaginary[i]) * imaginary[j];
            expected_imaginary[to] +=
                target.back().sign * (static_cast<double>(imaginary[i]) * real[j] -
                                      static_cast<double>(real[i]) * imaginary[j]);
          }
        }
      }
    }
    std::vector<float> first;
    for (const Kernels& kernels : AllKernels()) {
      std::vector<float> sum(2 * kGroups * kWidth, -1.0f);
      kernels.cross_spectra({real.data(), imaginary.data(), kFrames, microphones, kWidth,
                             target.data(), kGroups, sum.data(), sum.data() + kGroups * kWidth});
      for (int i = 0; i < kGroups * kWidth; ++i) {
        ASSERT_NEAR(sum[i], expected_real[i], 1e-4) << kernels.name;
        ASSERT_NEAR(sum[kGroups * kWidth + i], expected_imaginary[i], 1e-4) << kernels.name;
      }
      if (first.empty()) first = sum;
      EXPECT_EQ(sum, first) << kernels.name;
    }
  }
}

}  // namespace
}  // namespace soundmap::acoustics
