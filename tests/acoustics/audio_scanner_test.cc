#include "acoustics/audio_scanner.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

namespace soundmap::acoustics {
namespace {

using testing::AngleBetween_deg;
using testing::CalibrationOf;
using testing::Microphones;

constexpr int kRate_hz = 16000;
constexpr frames::TimeNs kStart_ns = 1'700'000'000'000'000'000;

Microphones FourMicrophones() {
  return {{0.1, 0, 0}, {-0.1, 0.02, 0}, {0, 0.1, 0.03}, {0.01, 0, 0.12}};
}

// A coarse grid keeps these tests short.
AcousticsConfig Coarse() {
  AcousticsConfig config;
  config.grid = EqualAreaGrid{.spacing_rad = geometry::RadFromDeg(10.0)};
  return config;
}

std::unique_ptr<AudioScanner> MakeScanner(const AcousticsConfig& config = Coarse()) {
  return AudioScanner::Create(config, CalibrationOf(FourMicrophones(), kRate_hz)).value();
}

std::vector<std::int16_t> Sound(int samples, std::uint64_t seed = 1) {
  std::mt19937_64 random(seed);
  return testing::Record(FourMicrophones(), kRate_hz, samples, {{{0.6, 0.0, 0.8}}}, 300.0, random);
}

// Samples first .. first + count of `sound`, stamped by a device that runs at the nominal rate.
frames::AudioBlock Block(const std::vector<std::int16_t>& sound, int first, int count,
                         frames::TimeNs start_ns = kStart_ns) {
  return {
      start_ns + first * 1'000'000'000LL / kRate_hz, kRate_hz, 4,
      std::vector<std::int16_t>(sound.begin() + first * 4, sound.begin() + (first + count) * 4)};
}

std::vector<LikelihoodScan> PushAll(AudioScanner& scanner, const std::vector<std::int16_t>& sound,
                                    int block_samples) {
  std::vector<LikelihoodScan> scans;
  const int samples = static_cast<int>(sound.size()) / 4;
  for (int first = 0; first < samples; first += block_samples) {
    auto pushed =
        scanner.Push(Block(sound, first, std::min(block_samples, samples - first))).value();
    std::move(pushed.begin(), pushed.end(), std::back_inserter(scans));
  }
  return scans;
}

void ExpectSame(const LikelihoodScan& a, const LikelihoodScan& b) {
  EXPECT_EQ(a.begin_ns, b.begin_ns);
  EXPECT_EQ(a.end_ns, b.end_ns);
  EXPECT_EQ(a.fault, b.fault);
  EXPECT_EQ(a.likelihood, b.likelihood);
  EXPECT_EQ(a.noise_floor, b.noise_floor);
  ASSERT_EQ(a.peaks.size(), b.peaks.size());
  for (std::size_t p = 0; p < a.peaks.size(); ++p) {
    EXPECT_EQ(a.peaks[p].direction_in_array, b.peaks[p].direction_in_array);
    EXPECT_EQ(a.peaks[p].power, b.peaks[p].power);
  }
}

TEST(AudioScanner, AScanEveryKHopsWithItsCaptureTime) {
  const auto scanner = MakeScanner();
  const auto scans = PushAll(*scanner, Sound(kRate_hz), 800);
  ASSERT_EQ(scans.size(), 7u);  // (16000 - 2200) / 2000 + 1
  for (std::size_t k = 0; k < scans.size(); ++k) {
    EXPECT_EQ(scans[k].fault, "");
    EXPECT_NEAR(static_cast<double>(scans[k].begin_ns - kStart_ns), k * 125e6, 10.0);
    EXPECT_NEAR(static_cast<double>(scans[k].end_ns - scans[k].begin_ns), 137.5e6, 10.0);
    EXPECT_EQ(static_cast<int>(scans[k].likelihood.size()), scanner->grid().size());
    ASSERT_FALSE(scans[k].peaks.empty());
    EXPECT_LT(AngleBetween_deg(scans[k].peaks[0].direction_in_array, {0.6, 0.0, 0.8}), 1.5);
  }
}

TEST(AudioScanner, TheCutIntoBlocksDoesNotMatter) {
  const auto sound = Sound(9000);
  const auto scans = PushAll(*MakeScanner(), sound, 800);
  for (const int block_samples : {160, 777, 9000}) {
    const auto others = PushAll(*MakeScanner(), sound, block_samples);
    ASSERT_EQ(others.size(), scans.size());
    for (std::size_t k = 0; k < scans.size(); ++k) {
      EXPECT_EQ(others[k].likelihood, scans[k].likelihood);
      EXPECT_NEAR(static_cast<double>(others[k].begin_ns - scans[k].begin_ns), 0.0, 100e3);
    }
  }
}

TEST(AudioScanner, AnArrayInAPlaneTellsTheRipplesOfItsPeaks) {
  for (const bool in_plane : {true, false}) {
    Microphones mics = FourMicrophones();
    if (in_plane) {
      for (Eigen::Vector3d& mic : mics) mic.z() = 0.0;
    }
    const auto scanner = AudioScanner::Create(Coarse(), CalibrationOf(mics, kRate_hz)).value();
    std::mt19937_64 random(2);
    const auto sound = testing::Record(mics, kRate_hz, 8000, {{{0.6, 0.0, 0.8}}}, 300.0, random);
    const auto scans = PushAll(*scanner, sound, 777);
    ASSERT_EQ(scans.size(), 3u);
    for (const LikelihoodScan& scan : scans) {
      ASSERT_FALSE(scan.levels.empty());
      EXPECT_EQ(scan.ripples.size(), in_plane ? scan.levels.size() : 0u);
      for (const frames::EchoRipple& ripple : scan.ripples) EXPECT_EQ(ripple.values.size(), 48u);
    }
    const auto other = AudioScanner::Create(Coarse(), CalibrationOf(mics, kRate_hz)).value();
    const auto again = PushAll(*other, sound, 1000);
    ASSERT_EQ(again.size(), scans.size());
    for (std::size_t k = 0; k < scans.size(); ++k) EXPECT_EQ(scans[k].ripples, again[k].ripples);
  }
}

TEST(AudioScanner, ThePaperProfileThresholdsThePower) {
  std::mt19937_64 random(2);
  const Microphones dome = testing::DomeArray();
  const Eigen::Vector3d source =
      geometry::DirectionFromAngles(geometry::RadFromDeg(-20.0), geometry::RadFromDeg(30.0));
  const auto scanner =
      AudioScanner::Create(AcousticsConfig::Paper(), CalibrationOf(dome, kRate_hz)).value();
  const auto samples = testing::Record(dome, kRate_hz, 2200, {{source}}, 200.0, random);
  const auto scans = scanner->Push({kStart_ns, kRate_hz, 16, samples}).value();
  ASSERT_EQ(scans.size(), 1u);
  const FrameLayout& layout = scanner->layout();
  const testing::LiteralSpectra spectra = testing::LiteralPhat(layout, 16, samples);
  int above = 0;
  for (int i = 0; i < scanner->grid().size(); i += 5) {
    const double power = testing::LiteralPower(layout, dome, spectra, scanner->grid()[i]);
    if (std::abs(power - 20.0) < 1e-3 || std::abs(power - 30.0) < 1e-3) continue;
    const float expected = power < 20.0 ? 0.1f : power > 30.0 ? 0.999f : 0.5f;
    ASSERT_EQ(scans[0].likelihood[i], expected) << "direction " << i;
    above += power > 30.0;
  }
  EXPECT_GT(above, 0);
  EXPECT_TRUE(scans[0].peaks.empty());
}

TEST(AudioScanner, NoScanSpansAGap) {
  const auto scanner = MakeScanner();
  const auto sound = Sound(12000);
  ASSERT_EQ(scanner->Push(Block(sound, 0, 3000)).value().size(), 1u);
  // 25 ms are missing: 400 samples.
  const auto at_gap = scanner->Push(Block(sound, 3400, 2000)).value();
  ASSERT_EQ(at_gap.size(), 1u);
  EXPECT_NE(at_gap[0].fault.find("gap of 0.025 s"), std::string::npos) << at_gap[0].fault;
  EXPECT_TRUE(at_gap[0].likelihood.empty());
  EXPECT_EQ(at_gap[0].begin_ns, kStart_ns + 125'000'000);
  EXPECT_EQ(at_gap[0].end_ns, kStart_ns + 187'500'000);
  const auto after = scanner->Push(Block(sound, 5400, 4000)).value();
  ASSERT_EQ(after.size(), 2u);
  EXPECT_EQ(after[0].fault, "");
  EXPECT_EQ(after[0].begin_ns, kStart_ns + 212'500'000);
  // The framing starts anew: the same as a scanner that heard nothing before.
  const auto fresh = MakeScanner();
  const auto alone = fresh->Push(Block(sound, 3400, 6000)).value();
  ASSERT_EQ(alone.size(), 2u);
  EXPECT_EQ(alone[0].likelihood, after[0].likelihood);
  EXPECT_EQ(alone[1].likelihood, after[1].likelihood);
}

TEST(AudioScanner, AJumpOfLessThan20MillisecondsIsJitter) {
  const auto scanner = MakeScanner();
  const auto sound = Sound(6000);
  ASSERT_TRUE(scanner->Push(Block(sound, 0, 2000)).ok());
  const auto scans = scanner->Push(Block(sound, 2000, 4000, kStart_ns + 19'000'000)).value();
  ASSERT_EQ(scans.size(), 2u);
  EXPECT_EQ(scans[0].fault, "");
}

TEST(AudioScanner, TimeRunningBackwardsIsRefusedAndChangesNothing) {
  const auto scanner = MakeScanner();
  const auto sound = Sound(8000);
  ASSERT_TRUE(scanner->Push(Block(sound, 0, 3000)).ok());
  const AudioScanner::State before = scanner->state();
  for (const frames::TimeNs back_ns :
       std::vector<frames::TimeNs>{-25'000'000, -1'000'000'000, -kStart_ns}) {
    const auto refused = scanner->Push(Block(sound, 3000, 1000, kStart_ns + back_ns));
    EXPECT_EQ(refused.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_NE(std::string(refused.status().message()).find("backwards"), std::string::npos);
    EXPECT_EQ(scanner->state(), before);
  }
  EXPECT_EQ(scanner->Push(Block(sound, 3000, 5000)).value().size(), 2u);
}

TEST(AudioScanner, BlocksThatDoNotFitAreRefused) {
  const auto scanner = MakeScanner();
  const AudioScanner::State before = scanner->state();
  const auto code = [&](frames::AudioBlock block) { return scanner->Push(block).status().code(); };
  const auto sound = Sound(100);
  frames::AudioBlock block = Block(sound, 0, 100);
  block.sample_rate_hz = 48000;
  EXPECT_EQ(code(block), absl::StatusCode::kInvalidArgument);
  block = Block(sound, 0, 100);
  block.channels = 0;
  EXPECT_EQ(code(block), absl::StatusCode::kInvalidArgument);
  block = Block(sound, 0, 100);
  block.samples.pop_back();
  EXPECT_EQ(code(block), absl::StatusCode::kInvalidArgument);
  for (const frames::TimeNs stamp_ns :
       {std::numeric_limits<frames::TimeNs>::min(), std::numeric_limits<frames::TimeNs>::max()}) {
    block = Block(sound, 0, 100);
    block.stamp_ns = stamp_ns;
    EXPECT_EQ(code(block), absl::StatusCode::kInvalidArgument);
  }
  block.stamp_ns = kStart_ns;
  block.samples.clear();
  EXPECT_TRUE(scanner->Push(block).value().empty());
  EXPECT_EQ(scanner->state(), before);
  EXPECT_FALSE(AudioScanner::Create(Coarse(), CalibrationOf({}, kRate_hz)).ok());
  EXPECT_FALSE(AudioScanner::Create(Coarse(), CalibrationOf(FourMicrophones(), 0)).ok());
}

TEST(AudioScanner, AMicrophoneThatStandsStillMakesAFault) {
  const auto fault = [](std::vector<std::int16_t> sound) {
    return MakeScanner()->Push(Block(sound, 0, 2200)).value().at(0);
  };
  const auto sound = Sound(2200);
  EXPECT_EQ(fault(sound).fault, "");

  // Of four, one can be done without.
  auto dead = sound;
  for (int s = 0; s < 2200; ++s) dead[4 * s + 2] = 0;
  EXPECT_EQ(fault(dead).fault, "");
  EXPECT_EQ(fault(dead).dead_microphones, std::vector<int>{2});
  for (int s = 0; s < 2200; ++s) dead[4 * s + 1] = 0;
  EXPECT_EQ(fault(dead).fault, "mic_1 and 1 more dead: constant signal");
  EXPECT_TRUE(fault(dead).dead_microphones.empty());
  EXPECT_TRUE(fault(dead).likelihood.empty());
  EXPECT_TRUE(fault(dead).peaks.empty());

  auto dropped = sound;
  for (int s = 1000; s < 1250; ++s) dropped[4 * s + 3] = -7;
  EXPECT_NE(fault(dropped).fault.find("mic_3 stood still"), std::string::npos);
  auto briefly = sound;
  for (int s = 1000; s < 1150; ++s) briefly[4 * s + 3] = -7;
  EXPECT_EQ(fault(briefly).fault, "");

  EXPECT_EQ(fault(std::vector<std::int16_t>(2200 * 4)).fault, "all 4 microphones stand still");
}

// As if the array had never had it.
TEST(AudioScanner, ADeadMicrophoneIsDoneWithout) {
  auto sound = Sound(4400);
  std::vector<std::int16_t> others;
  for (int s = 0; s < 4400; ++s) {
    sound[4 * s + 1] = 5;
    for (const int n : {0, 2, 3}) others.push_back(sound[4 * s + n]);
  }
  const auto with_dead = MakeScanner()->Push(Block(sound, 0, 4400)).value();
  auto three = FourMicrophones();
  three.erase(three.begin() + 1);
  const auto scanner = AudioScanner::Create(Coarse(), CalibrationOf(three, kRate_hz)).value();
  frames::AudioBlock block = Block(sound, 0, 4400);
  block.channels = 3;
  block.samples = others;
  const auto expected = scanner->Push(block).value();
  ASSERT_EQ(with_dead.size(), 2u);
  ASSERT_EQ(expected.size(), 2u);
  for (int k = 0; k < 2; ++k) {
    EXPECT_EQ(with_dead[k].likelihood, expected[k].likelihood);
    EXPECT_EQ(with_dead[k].noise_floor, expected[k].noise_floor);
    EXPECT_EQ(with_dead[k].peaks.size(), expected[k].peaks.size());
  }
}

// As if it had been wired right, once that is known.
TEST(AudioScanner, AnInvertedMicrophoneIsMended) {
  constexpr int kSamples = 5 * kRate_hz;
  const auto sound = Sound(kSamples);
  for (const bool one_dead : {false, true}) {
    auto right = sound;
    for (int s = 0; one_dead && s < kSamples; ++s) right[4 * s + 3] = 9;
    auto inverted = right;
    for (int s = 0; s < kSamples; ++s) inverted[4 * s + 1] *= -1;
    const auto expected = PushAll(*MakeScanner(), right, 4000);
    const auto scanner = MakeScanner();
    const auto scans = PushAll(*scanner, inverted, 4000);
    ASSERT_EQ(scans.size(), expected.size());
    std::size_t mended = 0;
    for (std::size_t k = 0; k < scans.size(); ++k) {
      EXPECT_TRUE(expected[k].inverted_microphones.empty());
      if (scans[k].inverted_microphones.empty()) continue;
      EXPECT_EQ(scans[k].inverted_microphones, std::vector<int>{1});
      ExpectSame(scans[k], expected[k]);
      ++mended;
    }
    EXPECT_GT(mended, scans.size() / 2);
    EXPECT_FALSE(scans[0].likelihood == expected[0].likelihood);
    // A scanner that goes on from here knows it.
    const auto restored = MakeScanner();
    ASSERT_TRUE(restored->Restore(scanner->state()).ok());
    const auto next = restored->Push(Block(inverted, 0, 4000, kStart_ns + 5'000'000'000)).value();
    ASSERT_FALSE(next.empty());
    EXPECT_EQ(next[0].inverted_microphones, std::vector<int>{1});
  }
}

TEST(AudioScanner, ThePaperProfileTakesTheMicrophonesAsTheyAre) {
  auto sound = Sound(5 * kRate_hz);
  for (std::size_t i = 1; i < sound.size(); i += 4) sound[i] *= -1;
  const auto scanner = MakeScanner(AcousticsConfig::Paper());
  for (const LikelihoodScan& scan : PushAll(*scanner, sound, 4000)) {
    EXPECT_TRUE(scan.inverted_microphones.empty());
  }
}

TEST(AudioScanner, EveryNumberIsFinite) {
  // Full scale, the smallest steps, and silence between clicks.
  std::mt19937_64 random(3);
  std::vector<std::vector<std::int16_t>> sounds(3, std::vector<std::int16_t>(2200 * 4));
  for (std::int16_t& value : sounds[0]) value = random() % 2 ? 32767 : -32768;
  for (std::int16_t& value : sounds[1]) value = random() % 2;
  for (int s = 0; s < 2200; ++s) {
    for (int n = 0; n < 4; ++n) sounds[2][4 * s + n] = s % 150 == 10 ? 20000 : 0;
  }
  for (const auto& sound : sounds) {
    const LikelihoodScan scan = MakeScanner()->Push(Block(sound, 0, 2200)).value().at(0);
    EXPECT_EQ(scan.fault, "");
    EXPECT_TRUE(std::isfinite(scan.noise_floor));
    for (const float value : scan.likelihood) ASSERT_TRUE(value > 0.0f && value < 1.0f);
    for (const Peak& peak : scan.peaks) {
      EXPECT_TRUE(std::isfinite(peak.power));
      EXPECT_NEAR(peak.direction_in_array.norm(), 1.0, 1e-9);
    }
  }
}

TEST(AudioScanner, ScanTimesFollowADriftingDevice) {
  // Ten minutes at 50 ppm.
  const auto scanner = MakeScanner([] {
    AcousticsConfig config = Coarse();
    config.grid = EqualAreaGrid{.spacing_rad = 0.5};
    return config;
  }());
  constexpr double kDrift = 50e-6;
  std::mt19937_64 random(4);
  std::uniform_int_distribution<int> jitter_ns(-500'000, 500'000);
  std::vector<std::int16_t> second(kRate_hz * 4);
  for (std::int16_t& value : second) value = static_cast<std::int16_t>(random());
  std::int64_t scan = 0;
  double worst_ms = 0.0;
  for (int s = 0; s < 600; ++s) {
    for (int part = 0; part < 10; ++part) {
      frames::AudioBlock block = Block(second, part * 1600, 1600);
      const double elapsed_s = (s + part / 10.0) * (1.0 + kDrift);
      block.stamp_ns = kStart_ns + frames::NsFromSeconds(elapsed_s) + jitter_ns(random);
      const std::vector<LikelihoodScan> results = scanner->Push(block).value();
      for (const LikelihoodScan& result : results) {
        const double true_s = static_cast<double>(scan) * 2000 / kRate_hz * (1.0 + kDrift);
        worst_ms = std::max(
            worst_ms, std::abs(frames::SecondsFromNs(result.begin_ns - kStart_ns) - true_s) * 1e3);
        ++scan;
      }
    }
  }
  EXPECT_EQ(scan, (600 * kRate_hz - 2200) / 2000 + 1);
  EXPECT_LT(worst_ms, 1.0);
}

TEST(AudioScanner, ARestoredStateContinuesBitForBit) {
  const auto sound = Sound(20000);
  const auto scanner = MakeScanner();
  for (int first = 0; first < 10000; first += 500) {
    ASSERT_TRUE(scanner->Push(Block(sound, first, 500, kStart_ns + first % 7 * 1000)).ok());
  }
  const AudioScanner::State state = scanner->state();
  EXPECT_FALSE(state.pending.empty());
  const auto restored = MakeScanner();
  ASSERT_TRUE(restored->Restore(state).ok());
  EXPECT_EQ(restored->state(), state);
  int scans = 0;
  for (int first = 10000; first < 20000; first += 500) {
    const auto a = scanner->Push(Block(sound, first, 500)).value();
    const auto b = restored->Push(Block(sound, first, 500)).value();
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t k = 0; k < a.size(); ++k, ++scans) ExpectSame(a[k], b[k]);
  }
  EXPECT_EQ(scans, 5);
  EXPECT_EQ(scanner->state(), restored->state());
}

TEST(AudioScanner, AStateThatCannotBeIsRefused) {
  const auto scanner = MakeScanner();
  ASSERT_TRUE(scanner->Push(Block(Sound(3000), 0, 3000)).ok());
  const AudioScanner::State good = scanner->state();
  const auto refused = [&](auto change) {
    AudioScanner::State state = good;
    change(state);
    return !MakeScanner()->Restore(state).ok();
  };
  EXPECT_FALSE(refused([](AudioScanner::State&) {}));
  EXPECT_TRUE(refused([](AudioScanner::State& s) { s.pending.pop_back(); }));
  EXPECT_TRUE(refused([](AudioScanner::State& s) { s.pending.resize(4 * 2200); }));
  EXPECT_TRUE(refused([](AudioScanner::State& s) { s.clock.clear(); }));
  EXPECT_TRUE(refused([](AudioScanner::State& s) { s.clock.push_back(s.clock.back()); }));
  EXPECT_TRUE(refused([](AudioScanner::State& s) { s.clock[0].stamp_ns = -1; }));
  EXPECT_TRUE(refused([](AudioScanner::State& s) { s.next_sample = 0; }));
  EXPECT_TRUE(refused([](AudioScanner::State& s) { s.polarity.inverted = {4}; }));
}

TEST(AudioScanner, ScannersOfOneArrayShareTheirTables) {
  const auto a = MakeScanner();
  const auto b = MakeScanner();
  EXPECT_EQ(&a->grid(), &b->grid());
  AcousticsConfig other = Coarse();
  other.speed_of_sound_mps += 1.0;
  EXPECT_NE(&MakeScanner(other)->grid(), &a->grid());
  Microphones moved = FourMicrophones();
  moved[2].x() += 1e-9;
  const auto c = AudioScanner::Create(Coarse(), CalibrationOf(moved, kRate_hz)).value();
  EXPECT_NE(&c->grid(), &a->grid());
  const auto d = AudioScanner::Create(Coarse(), CalibrationOf(FourMicrophones(), 48000)).value();
  EXPECT_NE(&d->grid(), &a->grid());
}

}  // namespace
}  // namespace soundmap::acoustics
