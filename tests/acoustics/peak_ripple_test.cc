#include "acoustics/peak_ripple.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>
#include <random>

#include "plane_waves.h"

namespace soundmap::acoustics {
namespace {

using testing::kSpeedOfSound_mps;
using testing::Microphones;

constexpr int kRate_hz = 16000;

Microphones Ring(int microphones) {
  Microphones mics;
  for (int m = 0; m < microphones; ++m) {
    const double angle = 2.0 * std::numbers::pi * m / microphones;
    mics.push_back({0.1 * std::cos(angle), 0.1 * std::sin(angle), 0.0});
  }
  return mics;
}

FrameLayout Layout(int rate_hz = kRate_hz) {
  return FrameLayout::Create(AcousticsConfig::Default(), rate_hz).value();
}

std::vector<frames::EchoRipple> RipplesOf(const FrameLayout& layout, const Microphones& mics,
                                          const std::vector<std::int16_t>& samples,
                                          const std::vector<Peak>& peaks) {
  const PeakRipple ripple(layout, kSpeedOfSound_mps, mics);
  PeakRipple::Frames frames;
  Stft stft(layout, static_cast<int>(mics.size()));
  stft.Analyze(samples, [&](int frame, const FrameSpectra& spectra) {
    ripple.Keep(frame, spectra, frames);
  });
  return ripple.Ripples(frames, peaks);
}

// White noise from one direction, and again `detour_m` later from another one, half as strong, on a
// grid of a hundredth of a sample.
std::vector<std::int16_t> WithEcho(const FrameLayout& layout, const Microphones& mics,
                                   const Eigen::Vector3d& from, const Eigen::Vector3d& echo_from,
                                   double echo, double detour_m, std::mt19937_64& random) {
  constexpr int kTones = 700;
  std::vector<double> sum(static_cast<std::size_t>(layout.scan_samples()) * mics.size());
  std::uniform_real_distribution<double> uniform;
  for (int tone = 0; tone < kTones; ++tone) {
    const double omega = 2.0 * std::numbers::pi * (50.0 + (tone + uniform(random)) * 4.0);
    const double start = 2.0 * std::numbers::pi * uniform(random);
    for (std::size_t m = 0; m < mics.size(); ++m) {
      const auto wave = [&](const Eigen::Vector3d& direction, double late_m) {
        return std::polar(1.0,
                          start + omega * (mics[m].dot(direction) - late_m) / kSpeedOfSound_mps);
      };
      std::complex<double> phasor = 100.0 * (wave(from, 0.0) + echo * wave(echo_from, detour_m));
      const std::complex<double> turn = std::polar(1.0, omega / layout.sample_rate_hz);
      for (std::size_t s = m; s < sum.size(); s += mics.size(), phasor *= turn) {
        sum[s] += phasor.real();
      }
    }
  }
  return {sum.begin(), sum.end()};
}

Eigen::Vector3d Direction(double azimuth, double elevation) {
  return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
          std::sin(elevation)};
}

TEST(PeakRipple, ShowsTheDetourOfAnEcho) {
  std::mt19937_64 random(1);
  const FrameLayout layout = Layout();
  for (const int microphones : {8, 15}) {
    const Microphones mics = Ring(microphones);
    for (const double detour_m : {0.6, 1.1, 1.9}) {
      const Eigen::Vector3d from = Direction(0.4, -0.2);
      const auto samples =
          WithEcho(layout, mics, from, Direction(0.4, -0.7), 0.7, detour_m, random);
      const auto ripples = RipplesOf(layout, mics, samples, {{from, 1.0}});
      ASSERT_EQ(ripples.size(), 1u);
      double best_m = 0.0;
      for (double m = 0.3; m < 2.6; m += 0.01) {
        if (ripples[0].Fit(m) > ripples[0].Fit(best_m)) best_m = m;
      }
      EXPECT_NEAR(best_m, detour_m, 0.05);
      EXPECT_GT(ripples[0].Fit(best_m), 2.5);
    }
  }
}

TEST(PeakRipple, WithoutAnEchoThereIsNone) {
  std::mt19937_64 random(2);
  const FrameLayout layout = Layout();
  const Microphones mics = Ring(8);
  const Eigen::Vector3d from = Direction(0.4, -0.2);
  constexpr int kScans = 40;
  double sum = 0.0;
  for (int scan = 0; scan < kScans; ++scan) {
    const auto samples = WithEcho(layout, mics, from, from, 0.0, 0.0, random);
    sum += RipplesOf(layout, mics, samples, {{from, 1.0}})[0].Fit(1.1);
  }
  EXPECT_NEAR(sum / kScans, 0.0, 4.0 / std::sqrt(kScans));
}

// The values themselves: delay and sum by the definition of the Fourier transform.
TEST(PeakRipple, IsTheLogarithmOfTheBeamsPowerLessItsMeanAround) {
  std::mt19937_64 random(3);
  const FrameLayout layout = Layout();
  const Microphones mics = Ring(5);
  const Eigen::Vector3d from = Direction(-1.0, 0.3), towards = Direction(-0.8, 0.2);
  const auto samples = WithEcho(layout, mics, from, Direction(2.0, 0.1), 0.5, 1.4, random);
  const int window = layout.window_samples;
  ASSERT_EQ(window, 400);
  std::vector<double> log_power(57);
  for (int bin = 1; bin <= 56; ++bin) {
    double power = 0.0;
    for (int frame = 0; frame < layout.frames_per_scan; ++frame) {
      std::complex<double> beam;
      for (std::size_t m = 0; m < mics.size(); ++m) {
        const double steer_rad =
            2.0 * std::numbers::pi * bin * 40.0 * mics[m].dot(towards) / kSpeedOfSound_mps;
        for (int s = 0; s < window; ++s) {
          const double turn_rad = 2.0 * std::numbers::pi * s / window;
          const std::size_t at = (frame * window / 2 + s) * mics.size() + m;
          beam += samples[at] * (0.5 - 0.5 * std::cos(turn_rad)) *
                  std::polar(1.0, -bin * turn_rad - steer_rad);
        }
      }
      power += std::norm(beam);
    }
    log_power[bin] = std::log(power);
  }
  std::vector<double> off;  // 120 Hz to 2 kHz
  double mean = 0.0;
  for (int bin = 3; bin <= 50; ++bin) {
    double sum = 0.0;
    int count = 0;
    for (int b = std::max(bin - 6, 1); b <= bin + 6; ++b, ++count) sum += log_power[b];
    off.push_back(std::clamp(log_power[bin] - sum / count, -3.0, 3.0));
    mean += off.back() / 48.0;
  }
  double square = 0.0;
  for (double& value : off) {
    value -= mean;
    square += value * value / 48.0;
  }
  const auto ripples = RipplesOf(layout, mics, samples, {{towards, 1.0}});
  ASSERT_EQ(ripples.size(), 1u);
  EXPECT_EQ(ripples[0].first_bin, 3);
  EXPECT_DOUBLE_EQ(ripples[0].waves_per_m, 40.0 / kSpeedOfSound_mps);
  ASSERT_EQ(ripples[0].values.size(), 48u);
  for (int i = 0; i < 48; ++i) {
    EXPECT_NEAR(ripples[0].values[i], 24.0 * off[i] / std::sqrt(square), 0.6) << i;
  }
}

TEST(PeakRipple, IsEmptyWhereNothingIsHeardOrTold) {
  const Microphones mics = Ring(8);
  const std::vector<Peak> peaks(8, Peak{Direction(0.0, 0.0), 1.0});
  const FrameLayout layout = Layout();
  std::vector<std::int16_t> samples(static_cast<std::size_t>(layout.scan_samples()) * mics.size());
  for (const auto& ripple : RipplesOf(layout, mics, samples, peaks)) {
    EXPECT_TRUE(ripple.values.empty());
  }
  std::mt19937_64 random(4);
  samples = WithEcho(layout, mics, Direction(1.0, 0.0), Direction(1.0, 0.5), 0.5, 1.0, random);
  EXPECT_EQ(RipplesOf(layout, mics, samples, peaks).size(), std::size_t{PeakRipple::kMaxPeaks});
  AcousticsConfig coarse = AcousticsConfig::Default();
  coarse.window_samples = 64;  // bins of 250 Hz
  const FrameLayout wide = FrameLayout::Create(coarse, kRate_hz).value();
  samples.resize(static_cast<std::size_t>(wide.scan_samples()) * mics.size());
  for (const auto& ripple : RipplesOf(wide, mics, samples, peaks)) {
    EXPECT_TRUE(ripple.values.empty());
  }
}

}  // namespace
}  // namespace soundmap::acoustics
