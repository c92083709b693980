#include "acoustics/polarity.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <random>
#include <utility>

#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

namespace soundmap::acoustics {
namespace {

using testing::Microphones;
using testing::RandomArray;
using testing::RandomDirection;

constexpr int kRate_hz = 16000;
constexpr int kScansPerSecond = 8;

FrameLayout Layout() { return FrameLayout::Create({}, kRate_hz).value(); }

// What the microphones of `gain` hear: the spectra of waves of equal power whose phases are new in
// each frame and bin (those of a still field: in each bin), and noise that is independent at each
// microphone.
class Field {
 public:
  Field(const Microphones& mic_in_array_m, int waves, double noise_rms, std::uint64_t seed,
        bool still = false)
      : gain(mic_in_array_m.size(), 1.0),
        mic_in_array_m_(mic_in_array_m),
        noise_rms_(noise_rms),
        still_(still),
        seed_(seed),
        random_(seed) {
    for (int w = 0; w < waves; ++w) directions_.push_back(RandomDirection(random_));
  }

  // Of the microphones but `without`, those of `turned` with their sign turned; holds until the
  // next call.
  FrameSpectra Frame(const std::vector<int>& turned, const std::vector<int>& without = {}) {
    const FrameLayout layout = Layout();
    const int window = layout.window_samples;
    const auto contains = [](const std::vector<int>& list, int n) {
      return std::find(list.begin(), list.end(), n) != list.end();
    };
    std::vector<int> channels;
    for (int n = 0; n < static_cast<int>(gain.size()); ++n) {
      if (!contains(without, n)) channels.push_back(n);
    }
    const std::size_t stride = 2 * (window + 1);
    rows_.assign(stride * ((channels.size() + 1) / 2), 0.0f);
    std::normal_distribution<double> normal;
    std::mt19937_64 same(seed_);
    for (int bin = 1; bin < 40; ++bin) {  // up to 1.6 kHz
      const double wave_number =
          2.0 * geometry::kPi * bin * kRate_hz / window / testing::kSpeedOfSound_mps;
      std::vector<std::complex<double>> amplitude;
      for (std::size_t w = 0; w < directions_.size(); ++w) {
        std::mt19937_64& random = still_ ? same : random_;
        amplitude.push_back(std::complex<double>(normal(random), normal(random)) /
                            std::sqrt(directions_.size()));
      }
      for (std::size_t i = 0; i < channels.size(); ++i) {
        const int n = channels[i];
        std::complex<double> x = noise_rms_ * std::complex(normal(random_), normal(random_));
        for (std::size_t w = 0; w < directions_.size(); ++w) {
          x += amplitude[w] * std::polar(1.0, wave_number * mic_in_array_m_[n].dot(directions_[w]));
        }
        x *= contains(turned, n) ? -gain[n] : gain[n];
        // Two real signals, a + j b.
        const std::complex<double> part = i % 2 == 0 ? 1.0 : std::complex<double>(0.0, 1.0);
        Add(i / 2 * stride + 2 * bin, part * x);
        Add(i / 2 * stride + 2 * (window - bin), part * std::conj(x));
      }
    }
    return {rows_.data(), static_cast<std::ptrdiff_t>(stride)};
  }

  std::vector<double> gain;  // of each microphone

 private:
  void Add(std::size_t at, std::complex<double> value) {
    rows_[at] += static_cast<float>(value.real());
    rows_[at + 1] += static_cast<float>(value.imag());
  }

  Microphones mic_in_array_m_;
  std::vector<Eigen::Vector3d> directions_;
  double noise_rms_;
  bool still_;
  std::uint64_t seed_;
  std::mt19937_64 random_;
  std::vector<float> rows_;
};

Polarity MakePolarity(const Microphones& mic_in_array_m) {
  return Polarity(Layout(), testing::kSpeedOfSound_mps, mic_in_array_m);
}

void Listen(Polarity& polarity, Field& field, double seconds) {
  for (int scan = 0; scan < seconds * kScansPerSecond; ++scan) {
    polarity.Add(field.Frame(polarity.inverted()), {});
  }
}

TEST(Polarity, NoHealthyMicrophoneIsEverCalledInverted) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> uniform;
  for (int trial = 0; trial < 60; ++trial) {
    const int count = 2 + static_cast<int>(random() % 31);
    const Microphones array = RandomArray(count, 0.02 + 0.4 * uniform(random), random);
    // From one wave to a diffuse field, from clean sound to hardly any.
    const int waves = trial % 3 == 0 ? 40 : 1 + static_cast<int>(random() % 3);
    const bool still = trial % 2 == 0;
    Field field(array, waves, std::pow(10.0, -2.0 + 3.0 * uniform(random)), trial, still);
    for (double& gain : field.gain) gain = std::pow(10.0, uniform(random));
    Polarity polarity = MakePolarity(array);
    for (int scan = 0; scan < 20 * kScansPerSecond; ++scan) {
      polarity.Add(field.Frame(polarity.inverted()), {});
      ASSERT_TRUE(polarity.inverted().empty()) << "trial " << trial << ", scan " << scan;
    }
  }
}

TEST(Polarity, InvertedMicrophonesAreFoundWithinSeconds) {
  std::mt19937_64 random(2);
  for (int trial = 0; trial < 40; ++trial) {
    const int count = 3 + static_cast<int>(random() % 30);
    const Microphones array = RandomArray(count, 0.15, random);
    Field field(array, 1 + trial % 4 * 10, 0.3, trial);
    std::vector<int> inverted;
    const int most = (count - 1) / 3;
    for (int n = 0; n < count && static_cast<int>(inverted.size()) < std::max(1, most); ++n) {
      if (random() % 4 == 0 || count - n <= 1 - static_cast<int>(inverted.size())) {
        inverted.push_back(n);
        field.gain[n] = -0.5;
      }
    }
    Polarity polarity = MakePolarity(array);
    Listen(polarity, field, 5.0);
    EXPECT_EQ(polarity.inverted(), inverted) << "trial " << trial << ", " << count;
    // Mended or not, the sound says the same.
    Listen(polarity, field, 5.0);
    EXPECT_EQ(polarity.inverted(), inverted) << "trial " << trial;
  }
}

TEST(Polarity, NoiseOfTheMicrophonesAloneSaysNothing) {
  std::mt19937_64 random(3);
  for (const int count : {3, 4, 8, 16}) {
    const Microphones array = RandomArray(count, 0.1, random);
    Field field(array, 0, 1.0, count);
    Polarity polarity = MakePolarity(array);
    for (int scan = 0; scan < 120 * kScansPerSecond; ++scan) {
      polarity.Add(field.Frame({}), {});
      ASSERT_TRUE(polarity.inverted().empty()) << count << " microphones, scan " << scan;
    }
  }
}

// The array stands still in a standing wave, with two of its microphones beyond a node.
TEST(Polarity, ANodeOfAHumIsNoInversion) {
  const FrameLayout layout = Layout();
  const Microphones array = {{0.1, 0, 0},      {0.0, 0.1, 0}, {0, -0.1, 0},      {0.05, 0.05, 0.1},
                             {0.05, -0.05, 0}, {-0.1, 0, 0},  {-0.1, 0.05, 0.05}};
  const std::pair<double, double> hums[] = {{120.0, 8000.0}, {150.0, 8000.0}, {290.0, 8000.0},
                                            {500.0, 8000.0}, {150.0, 200.0},  {200.0, 200.0},
                                            {333.0, 200.0},  {333.0, 20.0}};
  for (const auto& [hum_hz, amplitude] : hums) {
    const double wave_number = 2.0 * geometry::kPi * hum_hz / testing::kSpeedOfSound_mps;
    std::mt19937_64 random(4);
    std::normal_distribution<double> noise(0.0, 1.0);
    Polarity polarity = MakePolarity(array);
    Stft stft(layout, static_cast<int>(array.size()));
    for (int scan = 0; scan < 30 * kScansPerSecond; ++scan) {
      std::vector<std::int16_t> samples;
      for (int s = 0; s < layout.scan_samples(); ++s) {
        const double time_s =
            static_cast<double>(scan * layout.scan_period_samples() + s) / kRate_hz;
        for (const Eigen::Vector3d& mic_m : array) {
          const double pressure = amplitude * std::sin(2.0 * geometry::kPi * hum_hz * time_s) *
                                  std::sin(wave_number * (mic_m.x() + 0.05));
          samples.push_back(static_cast<std::int16_t>(std::lround(pressure + noise(random))));
        }
      }
      stft.Analyze(samples);
      polarity.Add(stft.newest_frame(), {});
      ASSERT_TRUE(polarity.inverted().empty())
          << hum_hz << " Hz of " << amplitude << ", scan " << scan;
    }
  }
}

TEST(Polarity, WhatIsMendedAtTheMicrophoneIsTurnedNoMore) {
  std::mt19937_64 random(5);
  const Microphones array = RandomArray(8, 0.1, random);
  Field field(array, 10, 0.3, 5);
  field.gain[6] = -1.0;
  Polarity polarity = MakePolarity(array);
  Listen(polarity, field, 30.0);
  EXPECT_EQ(polarity.inverted(), std::vector<int>{6});
  field.gain[6] = 1.0;
  Listen(polarity, field, 60.0);
  EXPECT_TRUE(polarity.inverted().empty());
  // Silence changes nothing.
  field.gain[2] = -1.0;
  Listen(polarity, field, 60.0);
  EXPECT_EQ(polarity.inverted(), std::vector<int>{2});
  field.gain.assign(8, 0.0);
  Listen(polarity, field, 60.0);
  EXPECT_EQ(polarity.inverted(), std::vector<int>{2});
}

TEST(Polarity, WhereTheSmallerGroupIsNotKnownItSaysNothing) {
  const auto said = [](const Microphones& array, const std::vector<int>& inverted) {
    Field field(array, 10, 0.1, 6);
    for (const int n : inverted) field.gain[n] = -1.0;
    Polarity polarity = MakePolarity(array);
    Listen(polarity, field, 20.0);
    return polarity.inverted();
  };
  const Microphones four = {{0.1, 0, 0}, {-0.1, 0, 0}, {0, 0.1, 0}, {0, 0, 0.1}};
  const std::vector<int> none;
  EXPECT_EQ(said(four, {1}), std::vector<int>{1});
  EXPECT_EQ(said(four, {0, 1}), none);
  EXPECT_EQ(said(four, {0, 1, 3}), std::vector<int>{2});  // the sign of all is no matter
  EXPECT_EQ(said({{0.1, 0, 0}, {-0.1, 0, 0}}, {1}), none);
  // Two that differ, beside two that hear nothing.
  Field field(four, 10, 0.1, 6);
  field.gain = {1.0, 0.0, -1.0, 0.0};
  Polarity polarity = MakePolarity(four);
  Listen(polarity, field, 20.0);
  EXPECT_EQ(polarity.inverted(), none);
  // A pair that is far from the others: nobody tells which of the two it is.
  EXPECT_EQ(said({{0, 0, 0}, {0.1, 0, 0}, {0, 0.1, 0}, {3, 0, 0}, {3.1, 0, 0}}, {3}), none);
  // Neighbours are too far apart.
  EXPECT_EQ(said({{0.3, 0, 0}, {-0.3, 0, 0}, {0, 0.3, 0}, {0, 0, 0.3}}, {1}), none);
}

TEST(Polarity, DeadMicrophonesDoNotHinder) {
  std::mt19937_64 random(7);
  const Microphones array = RandomArray(9, 0.1, random);
  for (const std::vector<int>& dead : {std::vector<int>{0}, {4, 7}, {8}}) {
    Field field(array, 10, 0.1, 7);
    field.gain[5] = -1.0;
    Polarity polarity = MakePolarity(array);
    for (int scan = 0; scan < 10 * kScansPerSecond; ++scan) {
      polarity.Add(field.Frame(polarity.inverted(), dead), dead);
    }
    EXPECT_EQ(polarity.inverted(), std::vector<int>{5});
  }
}

TEST(Polarity, ARestoredStateGoesOnBitForBit) {
  std::mt19937_64 random(8);
  const Microphones array = RandomArray(6, 0.1, random);
  Field field(array, 10, 0.1, 8);
  field.gain[1] = -1.0;
  Polarity polarity = MakePolarity(array);
  Listen(polarity, field, 3.0);
  Polarity restored = MakePolarity(array);
  ASSERT_TRUE(restored.Restore(polarity.state()));
  for (int scan = 0; scan < 20; ++scan) {
    const FrameSpectra frame = field.Frame(polarity.inverted());
    polarity.Add(frame, {});
    restored.Add(frame, {});
    EXPECT_EQ(restored.state(), polarity.state());
  }

  const auto refused = [&](auto change) {
    Polarity::State state = polarity.state();
    change(state);
    return !restored.Restore(state) && restored.state() == polarity.state();
  };
  EXPECT_TRUE(refused([](Polarity::State& s) { s.agreement.pop_back(); }));
  EXPECT_TRUE(refused([](Polarity::State& s) { s.agreement[3] = NAN; }));
  EXPECT_TRUE(refused([](Polarity::State& s) { s.bin_weight[0] = INFINITY; }));
  EXPECT_TRUE(refused([](Polarity::State& s) { s.inverted = {6}; }));
  EXPECT_TRUE(refused([](Polarity::State& s) { s.inverted = {2, 1}; }));
  EXPECT_TRUE(refused([](Polarity::State& s) { s.inverted = {0, 1, 2}; }));
}

}  // namespace
}  // namespace soundmap::acoustics
