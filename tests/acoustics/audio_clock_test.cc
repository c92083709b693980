#include "acoustics/audio_clock.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace soundmap::acoustics {
namespace {

// Stamps of 50 ms blocks of a device whose clock is off, seen through jitter and, now and then, a
// late delivery.
struct Device {
  double drift = 0.0;
  double jitter_s = 0.0;
  double late_s = 0.0;

  static constexpr int kRate_hz = 16000;
  static constexpr frames::TimeNs kStart_ns = 1'700'000'000'000'000'000;

  frames::TimeNs TrueTime(std::int64_t sample) const {
    return kStart_ns + std::llround(static_cast<double>(sample) * (1.0 + drift) / kRate_hz * 1e9);
  }
};

double WorstError_s(const Device& device, double duration_s, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> jitter_s(-device.jitter_s, device.jitter_s);
  AudioClock clock(Device::kRate_hz);
  double worst_s = 0.0;
  for (std::int64_t sample = 0; sample < duration_s * Device::kRate_hz; sample += 800) {
    const double late_s = random() % 20 == 0 ? device.late_s : 0.0;
    clock.Add({sample, device.TrueTime(sample) + frames::NsFromSeconds(jitter_s(random) + late_s)});
    if (sample < Device::kRate_hz) continue;  // the first second only settles
    for (const std::int64_t at : {sample - 2200, sample + 800}) {
      worst_s = std::max(worst_s,
                         std::abs(frames::SecondsFromNs(clock.TimeOf(at) - device.TrueTime(at))));
    }
  }
  return worst_s;
}

TEST(AudioClock, FollowsAnExactDeviceExactly) { EXPECT_LT(WorstError_s({}, 60.0, 1), 2e-9); }

TEST(AudioClock, StaysWithinAMillisecondOverTenMinutesOfDrift) {
  EXPECT_LT(WorstError_s({.drift = 50e-6}, 600.0, 2), 0.3e-3);
  EXPECT_LT(WorstError_s({.drift = -50e-6}, 600.0, 3), 0.3e-3);
  EXPECT_LT(WorstError_s({.drift = 50e-6, .jitter_s = 1e-3}, 600.0, 4), 1e-3);
}

TEST(AudioClock, LateStampsDoNotPullTheLine) {
  EXPECT_LT(WorstError_s({.drift = 50e-6, .jitter_s = 0.2e-3, .late_s = 15e-3}, 600.0, 5), 1e-3);
}

TEST(AudioClock, StateIsThePoints) {
  AudioClock clock(16000);
  for (int block = 0; block < 1000; ++block) {
    clock.Add({block * 800, 1000 + block * 50'002'500LL + (block % 7) * 10'000});
  }
  EXPECT_LE(clock.points().size(), 512u);
  AudioClock other(16000);
  other.Restore(clock.points());
  EXPECT_EQ(other.TimeOf(801'234), clock.TimeOf(801'234));
}

TEST(AudioClock, TinyBlocksDoNotFillTheMemory) {
  AudioClock clock(16000);
  for (int sample = 0; sample < 16000; ++sample) clock.Add({sample, sample * 62'500LL});
  EXPECT_EQ(clock.points().size(), 50u);
  EXPECT_EQ(clock.TimeOf(20000), 1'250'000'000);
}

}  // namespace
}  // namespace soundmap::acoustics
