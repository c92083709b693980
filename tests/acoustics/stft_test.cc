#include "acoustics/stft.h"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>

#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

namespace soundmap::acoustics {
namespace {

using testing::Record;

TEST(Stft, EqualsTheDefinitionOfTheTransform) {
  std::mt19937_64 random(1);
  AcousticsConfig config;
  config.frames_per_scan = 3;
  for (const int rate_hz : {8000, 16000, 44100}) {
    const FrameLayout layout = FrameLayout::Create(config, rate_hz).value();
    const testing::Microphones microphones = testing::RandomArray(3, 0.1, random);
    const auto samples =
        Record(microphones, rate_hz, layout.scan_samples(), {{{1, 0, 0}}}, 200.0, random);
    const PhatSpectra spectra = Stft(layout, 3).Analyze(samples);
    const testing::LiteralSpectra literal = testing::LiteralPhat(layout, 3, samples);
    std::size_t i = 0;
    for (int t = 0; t < layout.frames_per_scan; ++t) {
      for (int n = 0; n < 3; ++n) {
        for (int b = 0; b < layout.bins; ++b, ++i) {
          ASSERT_NEAR(spectra.real[spectra.index(t, n, b)], literal.real[i], 1e-3);
          ASSERT_NEAR(spectra.imaginary[spectra.index(t, n, b)], literal.imaginary[i], 1e-3);
        }
      }
    }
    ASSERT_EQ(i, literal.real.size());
  }
}

TEST(Stft, ASilentBinIsZeroAndOthersHaveMagnitudeOne) {
  AcousticsConfig config;
  config.f_min_hz = 800.0;
  config.f_max_hz = 1200.0;
  const FrameLayout layout = FrameLayout::Create(config, 16000).value();  // bins 20 .. 30
  // Microphone 0 is silent; a square wave with a period of 16 samples at microphone 1 has 1000 Hz
  // and odd harmonics only, so exactly the bins 24 .. 26 of a Hann window are not 0.
  std::vector<std::int16_t> samples(layout.scan_samples() * 2);
  for (int s = 0; s < layout.scan_samples(); ++s) samples[2 * s + 1] = s % 16 < 8 ? 9000 : -9000;
  const PhatSpectra spectra = Stft(layout, 2).Analyze(samples);
  for (int t = 0; t < spectra.frames; ++t) {
    for (int b = 0; b < spectra.bins; ++b) {
      const auto magnitude = [&](int n) {
        const std::size_t i = spectra.index(t, n, b);
        return std::hypot(spectra.real[i], spectra.imaginary[i]);
      };
      EXPECT_EQ(magnitude(0), 0.0f);
      if (b >= 4 && b <= 6) {
        EXPECT_NEAR(magnitude(1), 1.0f, 1e-6);
      } else {
        EXPECT_EQ(magnitude(1), 0.0f) << "bin " << b;
      }
    }
  }
}

}  // namespace
}  // namespace soundmap::acoustics
