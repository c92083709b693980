#include "sources/simulation/sounds.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <filesystem>
#include <fstream>
#include <numbers>

#include "sources/simulation/wav_file.h"
#include "tests/simulation/scene_texts.h"

namespace soundmap::simulation {
namespace {

constexpr int kRateHz = 16000;

std::vector<float> Play(SoundKind kind, double seconds, int seed = 1) {
  SourceConfig source;
  source.kind = kind;
  auto sound = MakeSound(source, kRateHz, 0, std::mt19937_64(seed));
  EXPECT_TRUE(sound.ok());
  std::vector<float> samples(static_cast<std::size_t>(seconds * kRateHz));
  (*sound)->Next(samples);
  return samples;
}

double Rms(const std::vector<float>& samples) {
  double square = 0.0;
  for (float sample : samples) square += static_cast<double>(sample) * sample;
  return std::sqrt(square / samples.size());
}

// Mean power density around a frequency, by Hann frames of 64 ms.
double DensityDb(const std::vector<float>& samples, double from_hz, double to_hz) {
  constexpr int kFrame = 1024;
  double power = 0.0;
  int bins = 0;
  for (double f_hz = from_hz; f_hz <= to_hz; f_hz += kRateHz / static_cast<double>(kFrame)) {
    const auto step = std::polar(1.0, -2 * std::numbers::pi * f_hz / kRateHz);
    for (std::size_t start = 0; start + kFrame <= samples.size(); start += 4 * kFrame) {
      std::complex<double> sum = 0.0, turn = 1.0;
      for (int i = 0; i < kFrame; ++i, turn *= step) {
        sum += (0.5 - 0.5 * std::cos(2 * std::numbers::pi * i / kFrame)) * turn *
               static_cast<double>(samples[start + i]);
      }
      power += std::norm(sum);
      ++bins;
    }
  }
  return 10 * std::log10(power / bins);
}

TEST(Sounds, EachKindHasUnitRms) {
  for (SoundKind kind : {SoundKind::kFan, SoundKind::kHiss, SoundKind::kHum, SoundKind::kMachine,
                         SoundKind::kWhite}) {
    EXPECT_NEAR(Rms(Play(kind, 20.0)), 1.0, 0.03);
  }
  EXPECT_NEAR(Rms(Play(SoundKind::kSpeech, 120.0)), 1.0, 0.2);
}

TEST(Sounds, SpectraAreThoseOfTheirKinds) {
  const auto fan = Play(SoundKind::kFan, 20.0);
  EXPECT_NEAR(DensityDb(fan, 800, 1200) - DensityDb(fan, 3200, 4800), 6.0, 1.5);  // 1/f
  const auto hiss = Play(SoundKind::kHiss, 10.0);
  EXPECT_GT(DensityDb(hiss, 3500, 4500) - DensityDb(hiss, 300, 500), 15.0);
  const auto white = Play(SoundKind::kWhite, 10.0);
  EXPECT_NEAR(DensityDb(white, 500, 1500) - DensityDb(white, 5000, 6000), 0.0, 0.5);
  const auto hum = Play(SoundKind::kHum, 10.0);
  EXPECT_GT(DensityDb(hum, 1000, 1000) - DensityDb(hum, 1047, 1047), 10.0);
}

// The long-term average of speech in twelve languages (Byrne et al., JASA 96, 1994), octaves
// against that of 500 Hz: summed from the third octaves of the combined table.
TEST(Sounds, SpeechHasTheSpectrumOfSpeech) {
  const auto octave_db = [speech = Play(SoundKind::kSpeech, 60.0)](double middle_hz) {
    return DensityDb(speech, middle_hz / std::sqrt(2.0), middle_hz * std::sqrt(2.0)) +
           10.0 * std::log10(middle_hz);
  };
  const double at_500_hz = octave_db(500.0);
  EXPECT_NEAR(octave_db(250.0) - at_500_hz, -1.8, 4.0);
  EXPECT_NEAR(octave_db(1000.0) - at_500_hz, -6.8, 4.0);
  EXPECT_NEAR(octave_db(2000.0) - at_500_hz, -11.7, 4.0);
  EXPECT_NEAR(octave_db(4000.0) - at_500_hz, -15.9, 4.0);
}

TEST(Sounds, SpeechHasPausesAndLoudParts) {
  const auto speech = Play(SoundKind::kSpeech, 60.0);
  int quiet = 0, frames = 0;
  for (std::size_t start = 0; start + 800 <= speech.size(); start += 800, ++frames) {
    quiet += Rms({speech.begin() + start, speech.begin() + start + 800}) < 0.1;
  }
  EXPECT_GT(quiet, frames / 20);
  EXPECT_LT(quiet, frames / 2);
}

TEST(Sounds, TheEngineDecidesTheNoise) {
  EXPECT_EQ(Play(SoundKind::kFan, 0.1, 5), Play(SoundKind::kFan, 0.1, 5));
  EXPECT_NE(Play(SoundKind::kFan, 0.1, 5), Play(SoundKind::kFan, 0.1, 6));
}

std::string WriteWav(const std::string& name, int rate_hz,
                     const std::vector<std::int16_t>& samples) {
  const std::string path = FreshFolder() + "/" + name;
  std::ofstream file(path, std::ios::binary);
  const auto put = [&](auto value) { file.write(reinterpret_cast<char*>(&value), sizeof(value)); };
  file << "RIFF";
  put(static_cast<std::uint32_t>(36 + 2 * samples.size()));
  file << "WAVEfmt ";
  put(std::uint32_t{16});
  put(std::uint16_t{1});
  put(std::uint16_t{1});
  put(static_cast<std::uint32_t>(rate_hz));
  put(static_cast<std::uint32_t>(2 * rate_hz));
  put(std::uint16_t{2});
  put(std::uint16_t{16});
  file << "data";
  put(static_cast<std::uint32_t>(2 * samples.size()));
  for (auto sample : samples) put(sample);
  return path;
}

TEST(Sounds, AWavFileIsResampledNormalizedAndRepeated) {
  std::vector<std::int16_t> tone(4410);
  for (std::size_t i = 0; i < tone.size(); ++i) {
    tone[i] = static_cast<std::int16_t>(3000 * std::sin(2 * std::numbers::pi * 1000 * i / 44100));
  }
  SourceConfig source;
  source.kind = SoundKind::kWav;
  source.wav_path = WriteWav("tone.wav", 44100, tone);
  auto sound = MakeSound(source, kRateHz, 0, std::mt19937_64(1));
  ASSERT_TRUE(sound.ok()) << sound.status();
  std::vector<float> samples(4000);
  (*sound)->Next(samples);
  EXPECT_NEAR(Rms(samples), 1.0, 0.02);
  for (int i = 200; i < 1400; ++i) {
    ASSERT_NEAR(samples[i], std::sqrt(2.0) * std::sin(2 * std::numbers::pi * i / 16.0), 0.03);
    ASSERT_EQ(samples[i], samples[i + 1600]);
  }
}

TEST(Sounds, DamagedWavFilesAreRefusedWithTheirName) {
  SourceConfig source;
  source.kind = SoundKind::kWav;
  const std::string folder = FreshFolder();
  source.wav_path = folder + "/none.wav";
  EXPECT_THAT(std::string(MakeSound(source, kRateHz, 0, {}).status().message()),
              ::testing::HasSubstr("none.wav"));
  std::string whole;
  {
    const std::string path = WriteWav("whole.wav", 16000, std::vector<std::int16_t>(100, 5));
    std::ifstream file(path, std::ios::binary);
    whole.assign(std::istreambuf_iterator<char>(file), {});
  }
  for (std::size_t length = 0; length <= whole.size(); ++length) {
    source.wav_path = folder + "/cut.wav";
    std::filesystem::create_directories(folder);
    std::ofstream(source.wav_path, std::ios::binary) << whole.substr(0, length);
    EXPECT_EQ(MakeSound(source, kRateHz, 0, {}).ok(), length >= 46) << length;
  }
}

}  // namespace
}  // namespace soundmap::simulation
