#include "frames/echo_ripple.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace soundmap::frames {
namespace {

constexpr double kWavesPerM = 40.0 / 343.0;

EchoRipple Noise(std::mt19937_64& random) {
  std::normal_distribution<double> normal(0.0, EchoRipple::kValuesPerSigma);
  EchoRipple ripple{kWavesPerM, 3, {}};
  for (int i = 0; i < 47; ++i) {
    ripple.values.push_back(static_cast<std::int8_t>(std::lround(normal(random))));
  }
  return ripple;
}

// Against the sum as it is written, bin by bin.
TEST(EchoRipple, IsFittedByACosineOfTheDetour) {
  std::mt19937_64 random(1);
  for (int trial = 0; trial < 100; ++trial) {
    const EchoRipple ripple = Noise(random);
    const double detour_m = std::uniform_real_distribution<double>(-3.4, 3.4)(random);
    double sum = 0.0;
    for (int i = 0; i < 47; ++i) {
      sum += ripple.values[i] / EchoRipple::kValuesPerSigma *
             std::cos(2.0 * std::numbers::pi * (3 + i) * kWavesPerM * detour_m);
    }
    EXPECT_NEAR(ripple.Fit(detour_m), sum / std::sqrt(47.0 / 2.0), 1e-9);
  }
}

TEST(EchoRipple, WithoutAnEchoTheFitIsStandardNormal) {
  std::mt19937_64 random(2);
  constexpr int kTrials = 4000;
  double sum = 0.0, squares = 0.0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const double fit = Noise(random).Fit(1.3);
    sum += fit;
    squares += fit * fit;
  }
  EXPECT_NEAR(sum / kTrials, 0.0, 4.0 / std::sqrt(kTrials));
  EXPECT_NEAR(squares / kTrials, 1.0, 4.0 * std::sqrt(2.0 / kTrials));
}

TEST(EchoRipple, SaysNothingOfWhatItCannotTell) {
  std::mt19937_64 random(3);
  const EchoRipple ripple = Noise(random);
  EXPECT_NE(ripple.Fit(0.4 / kWavesPerM - 0.01), 0.0);
  EXPECT_EQ(ripple.Fit(0.4 / kWavesPerM + 0.01), 0.0);
  EXPECT_EQ(ripple.Fit(std::numeric_limits<double>::quiet_NaN()), 0.0);
  EXPECT_EQ(EchoRipple().Fit(1.0), 0.0);
}

}  // namespace
}  // namespace soundmap::frames
