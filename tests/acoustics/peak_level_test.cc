#include "acoustics/peak_level.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>
#include <random>
#include <span>

#include "plane_waves.h"

namespace soundmap::acoustics {
namespace {

using testing::DomeArray;
using testing::kSpeedOfSound_mps;
using testing::Microphones;
using testing::PlaneWave;

double Db(double power) { return 10.0 * std::log10(power); }

constexpr int kTones = 160;

// The sinusoids of the w-th wave: one somewhere in each of kTones equal parts of 80 Hz to 90 % of
// half the rate.
struct Tone {
  double frequency_hz;
  double start_rad;
};
std::vector<Tone> TonesOf(std::size_t w, int sample_rate_hz) {
  std::mt19937_64 random(100 + w);
  std::uniform_real_distribution<double> uniform;
  const double part_hz = (0.45 * sample_rate_hz - 80.0) / kTones;
  std::vector<Tone> tones(kTones);
  for (int i = 0; i < kTones; ++i) {
    tones[i].frequency_hz = 80.0 + (i + uniform(random)) * part_hz;
    tones[i].start_rad = 2.0 * std::numbers::pi * uniform(random);
  }
  return tones;
}

// The frame of a scan that levels are taken from, `time_s` after the start.
void AddFrame(const Microphones& mics, int sample_rate_hz, const std::vector<PlaneWave>& waves,
              double time_s, std::span<double> frame) {
  const std::size_t channels = mics.size();
  for (std::size_t w = 0; w < waves.size(); ++w) {
    const double amplitude = waves[w].rms * std::sqrt(2.0 / kTones);
    for (const Tone& tone : TonesOf(w, sample_rate_hz)) {
      const double omega = 2.0 * std::numbers::pi * tone.frequency_hz;
      const std::complex<double> turn = std::polar(1.0, omega / sample_rate_hz);
      for (std::size_t n = 0; n < channels; ++n) {
        const double arrival_s = -mics[n].dot(waves[w].direction_in_array) / kSpeedOfSound_mps;
        std::complex<double> phasor =
            std::polar(amplitude, tone.start_rad + omega * (time_s - arrival_s));
        for (std::size_t s = n; s < frame.size(); s += channels, phasor *= turn) {
          frame[s] += phasor.real();
        }
      }
    }
  }
}

// The mean over the frames of many scans, as those who ask for a level take it.
std::vector<frames::BandPowers> MeanLevels(const Microphones& mics, int sample_rate_hz,
                                           const std::vector<PlaneWave>& waves, double noise_rms,
                                           const std::vector<Peak>& peaks) {
  constexpr int kScans = 80;
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise(0.0, noise_rms);
  const FrameLayout layout =
      FrameLayout::Create(AcousticsConfig::Default(), sample_rate_hz).value();
  const PeakLevel level(layout, kSpeedOfSound_mps, mics);
  Stft stft(layout, static_cast<int>(mics.size()));
  std::vector<frames::BandPowers> mean(peaks.size(), frames::BandPowers{});
  for (int k = 0; k < kScans; ++k) {
    std::vector<double> frame(static_cast<std::size_t>(layout.window_samples) * mics.size());
    AddFrame(mics, sample_rate_hz, waves, 0.1237 * k, frame);
    std::vector<std::int16_t> pcm(static_cast<std::size_t>(layout.scan_samples()) * mics.size());
    std::transform(frame.begin(), frame.end(),
                   pcm.end() - static_cast<std::ptrdiff_t>(frame.size()), [&](double value) {
                     return static_cast<std::int16_t>(std::lround(value + noise(random)));
                   });
    stft.Analyze(pcm);
    const auto levels = level.Levels(stft.newest_frame(), peaks);
    EXPECT_EQ(levels.size(), peaks.size());
    for (std::size_t i = 0; i < levels.size(); ++i) {
      for (int band = 0; band < frames::kOctaveBands; ++band) {
        mean[i][band] += levels[i][band] / kScans;
      }
    }
  }
  return mean;
}

// Of the w-th wave; 0 if it has too few sinusoids in the band for its edges not to matter.
double BandPower(const PlaneWave& wave, std::size_t w, int band, int sample_rate_hz) {
  int in_band = 0;
  for (const Tone& tone : TonesOf(w, sample_rate_hz)) {
    in_band += tone.frequency_hz >= frames::OctaveBegin_hz(band) &&
               tone.frequency_hz < frames::OctaveEnd_hz(band);
  }
  return in_band < 8 ? 0.0 : wave.rms * wave.rms / (32768.0 * 32768.0) * in_band / kTones;
}

TEST(PeakLevel, AWaveHasItsOwnLevelInEveryBand) {
  std::mt19937_64 random(5);
  for (const int rate_hz : {16000, 48000}) {
    for (const Microphones& mics : {DomeArray(), testing::RandomArray(7, 0.1, random)}) {
      const PlaneWave wave{testing::RandomDirection(random), 1000.0};
      const auto levels =
          MeanLevels(mics, rate_hz, {wave}, /*noise_rms=*/100.0, {{wave.direction_in_array, 10.0}});
      const int bands = frames::OctaveBandsAt(rate_hz);
      EXPECT_EQ(bands, rate_hz == 16000 ? 6 : 7);
      int compared = 0;
      for (int band = 0; band < bands; ++band) {
        const double expected = BandPower(wave, 0, band, rate_hz);
        if (expected == 0.0) continue;
        ++compared;
        EXPECT_NEAR(Db(levels[0][band]), Db(expected), 0.5)
            << frames::OctaveCentre_hz(band) << " Hz, " << mics.size() << " microphones";
      }
      EXPECT_GE(compared, 3);
      for (int band = bands; band < frames::kOctaveBands; ++band) EXPECT_EQ(levels[0][band], 0.0f);
    }
  }
}

TEST(PeakLevel, TwoSourcesTenDecibelsApartKeepTheirLevels) {
  const Microphones mics = DomeArray();
  const PlaneWave strong{Eigen::Vector3d(1.0, 0.2, 0.4).normalized(), 2000.0};
  const PlaneWave weak{Eigen::Vector3d(-0.3, 1.0, 0.5).normalized(), 2000.0 / std::sqrt(10.0)};
  const auto levels =
      MeanLevels(mics, 16000, {strong, weak}, /*noise_rms=*/50.0,
                 {{strong.direction_in_array, 20.0}, {weak.direction_in_array, 5.0}});
  // From 1 kHz on the array tells the two apart.
  for (int band = 3; band < 6; ++band) {
    EXPECT_NEAR(Db(levels[0][band]), Db(BandPower(strong, 0, band, 16000)), 0.5) << band;
    EXPECT_NEAR(Db(levels[1][band]), Db(BandPower(weak, 1, band, 16000)), 1.0) << band;
  }
}

TEST(PeakLevel, NoiseOfTheMicrophonesIsNoSource) {
  const auto levels =
      MeanLevels(DomeArray(), 16000, {}, /*noise_rms=*/1000.0, {{Eigen::Vector3d::UnitX(), 1.0}});
  const double noise = 1000.0 * 1000.0 / (32768.0 * 32768.0);
  for (int band = 0; band < 6; ++band) {
    const double in_band =
        noise * (frames::OctaveEnd_hz(band) - frames::OctaveBegin_hz(band)) / 8000.0;
    EXPECT_LT(std::abs(levels[0][band]), 0.05 * in_band) << band;
  }
}

TEST(PeakLevel, SilenceAndManyPeaksAreNoTrouble) {
  std::mt19937_64 random(9);
  const FrameLayout layout = FrameLayout::Create(AcousticsConfig::Default(), 16000).value();
  const PeakLevel level(layout, kSpeedOfSound_mps, DomeArray());
  Stft stft(layout, 16);
  const std::vector<std::int16_t> silence(static_cast<std::size_t>(layout.scan_samples()) * 16, 0);
  stft.Analyze(silence);
  const std::vector<Peak> peaks(20, Peak{Eigen::Vector3d::UnitX(), 1.0});
  const auto levels = level.Levels(stft.newest_frame(), peaks);
  ASSERT_EQ(levels.size(), static_cast<std::size_t>(PeakLevel::kMaxPeaks));
  for (const auto& bands : levels) EXPECT_EQ(bands, frames::BandPowers{});
  EXPECT_TRUE(level.Levels(stft.newest_frame(), {}).empty());
}

}  // namespace
}  // namespace soundmap::acoustics
