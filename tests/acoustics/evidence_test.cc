#include "acoustics/evidence.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "acoustics/peak_finder.h"
#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

namespace soundmap::acoustics {
namespace {

using geometry::DirectionGrid;
using testing::AngleBetween_deg;
using testing::kSpeedOfSound_mps;
using testing::Microphones;
using testing::PlaneWave;

// The peaks that one scan is sure of.
PeakEvidence Certain() {
  PeakEvidence evidence;
  evidence.faint_spreads = 1e3;
  return evidence;
}

class Listener {
 public:
  explicit Listener(const Microphones& microphones,
                    const DirectionGrid& grid = AcousticsConfig{}.MakeGrid(),
                    int sample_rate_hz = 16000)
      : microphones_(microphones),
        layout_(FrameLayout::Create({}, sample_rate_hz).value()),
        srp_(SrpPhat::Create(layout_, kSpeedOfSound_mps, microphones, grid).value()),
        finder_(Certain(), layout_, kSpeedOfSound_mps, microphones, srp_),
        stft_(layout_, static_cast<int>(microphones.size())) {}

  Peaks Hear(const std::vector<PlaneWave>& waves, double noise_rms, std::mt19937_64& random) {
    const auto samples = testing::Record(microphones_, layout_.sample_rate_hz,
                                         layout_.scan_samples(), waves, noise_rms, random);
    return finder_.Find(srp_->Scan(stft_.Analyze(samples)));
  }
  const PeakFinder& finder() const { return finder_; }
  const DirectionGrid& grid() const { return srp_->grid(); }

 private:
  Microphones microphones_;
  FrameLayout layout_;
  std::shared_ptr<const SrpPhat> srp_;
  PeakFinder finder_;
  Stft stft_;
};

TEST(DoubleThreshold, IsEquation6) {
  const float above_30 = std::nextafter(30.0f, 31.0f);
  const float below_20 = std::nextafter(20.0f, 19.0f);
  const std::vector<float> power = {0.0f, below_20, 20.0f, 25.0f, 30.0f, above_30, 51.0f};
  const std::vector<float> expected = {0.1f, 0.1f, 0.5f, 0.5f, 0.5f, 0.999f, 0.999f};
  EXPECT_EQ(DoubleThresholdLikelihood(power, DoubleThreshold{}), expected);
}

TEST(ScaledPower, IsLinearFromTheLeastPowerToTheMost) {
  const std::vector<float> power = {5.0f, -1.0f, 2.0f, 11.0f};
  const std::vector<float> expected = {0.5f, 0.05f, 0.275f, 0.95f};
  const std::vector<float> likelihood = ScaledPowerLikelihood(power, ScaledPower{});
  ASSERT_EQ(likelihood.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_FLOAT_EQ(likelihood[i], expected[i]);
  const std::vector<float> even(3, 7.0f);
  EXPECT_EQ(ScaledPowerLikelihood(even, ScaledPower{}), std::vector<float>(3, 0.05f));
  EXPECT_TRUE(ScaledPowerLikelihood({}, ScaledPower{}).empty());
}

TEST(FindPeaks, FindsThreeWavesOfUnequalLevelAndRarelyMore) {
  std::mt19937_64 random(11);
  Listener listener(testing::DomeArray());
  int trials = 0;
  int more = 0;
  while (trials < 20) {
    std::vector<PlaneWave> waves;
    for (const double level_db : {0.0, -6.0, -12.0}) {
      Eigen::Vector3d direction = testing::RandomDirection(random);
      direction.z() = std::abs(direction.z());
      waves.push_back({direction, 2000.0 * std::pow(10.0, level_db / 20.0)});
    }
    const auto apart = [&](int a, int b) {
      return AngleBetween_deg(waves[a].direction_in_array, waves[b].direction_in_array) > 50.0;
    };
    if (!apart(0, 1) || !apart(0, 2) || !apart(1, 2)) continue;
    ++trials;
    const Peaks found = listener.Hear(waves, 20.0, random);
    ASSERT_GE(found.peaks.size(), 3u) << "trial " << trials;
    // What is left of a wave far stronger.
    if (found.peaks.size() > 3) {
      ++more;
      EXPECT_LT(found.peaks[3].power - found.noise_floor,
                0.5 * (found.peaks[2].power - found.noise_floor));
    }
    EXPECT_GE(found.peaks[0].power, found.peaks[1].power);
    EXPECT_GE(found.peaks[1].power, found.peaks[2].power);
    const double allowed_deg[] = {1.0, 2.0, 5.0};
    for (int w = 0; w < 3; ++w) {
      EXPECT_LT(AngleBetween_deg(found.peaks[w].direction_in_array, waves[w].direction_in_array),
                allowed_deg[w])
          << "trial " << trials << " wave " << w;
    }
  }
  EXPECT_LE(more, 4);
}

TEST(FindPeaks, RefinesBelowTheGridSpacing) {
  std::mt19937_64 random(12);
  Listener listener(testing::DomeArray());
  double worst_deg = 0.0;
  for (int trial = 0; trial < 20; ++trial) {
    const Eigen::Vector3d source = testing::RandomDirection(random);
    const Peaks found = listener.Hear({{source}}, 100.0, random);
    ASSERT_EQ(found.peaks.size(), 1u);
    worst_deg = std::max(worst_deg, AngleBetween_deg(found.peaks[0].direction_in_array, source));
  }
  EXPECT_LT(worst_deg, 0.15);
}

TEST(FindPeaks, ArraysOfAnySizeAndRateFindAWave) {
  std::mt19937_64 random(13);
  const DirectionGrid grid = DirectionGrid::EqualArea(geometry::RadFromDeg(3.0));
  for (const int rate_hz : {8000, 16000, 48000}) {
    for (const int count : {4, 7, 32}) {
      Listener listener(testing::RandomArray(count, 0.15, random), grid, rate_hz);
      const Eigen::Vector3d source = testing::RandomDirection(random);
      const Peaks found = listener.Hear({{source}}, 100.0, random);
      ASSERT_GE(found.peaks.size(), 1u) << count << " microphones at " << rate_hz;
      EXPECT_LT(AngleBetween_deg(found.peaks[0].direction_in_array, source), 1.0)
          << count << " microphones at " << rate_hz;
    }
  }
}

TEST(FindPeaks, WhiteNoiseGivesNoPeaks) {
  std::mt19937_64 random(14);
  const DirectionGrid grid = DirectionGrid::EqualArea(geometry::RadFromDeg(3.0));
  int scans = 0;
  int with_peaks = 0;
  for (const int count : {2, 3, 6, 16, 32}) {
    Listener listener(testing::RandomArray(count, 0.15, random), grid);
    for (int k = 0; k < 200; ++k, ++scans) {
      with_peaks += !listener.Hear({}, 300.0, random).peaks.empty();
    }
  }
  EXPECT_LE(with_peaks, scans / 200);
}

TEST(FindPeaks, AWaveFromOutsideTheGridIsNotReported) {
  std::mt19937_64 random(15);
  const DirectionGrid sector = DirectionGrid::Sector(
      geometry::RadFromDeg(-45.0), geometry::RadFromDeg(45.0), geometry::RadFromDeg(-30.0),
      geometry::RadFromDeg(30.0), geometry::RadFromDeg(2.0));
  Listener listener(testing::DomeArray(), sector);
  const auto direction = [](double azimuth_deg) {
    return geometry::DirectionFromAngles(geometry::RadFromDeg(azimuth_deg), 0.1);
  };
  EXPECT_EQ(listener.Hear({{direction(52.0)}}, 100.0, random).peaks.size(), 0u);
  const Peaks inside = listener.Hear({{direction(40.0)}}, 100.0, random);
  ASSERT_EQ(inside.peaks.size(), 1u);
  EXPECT_LT(AngleBetween_deg(inside.peaks[0].direction_in_array, direction(40.0)), 0.3);
}

TEST(FindPeaks, APlanarArrayReportsOneImageAndBothSpeak) {
  std::mt19937_64 random(16);
  Microphones plane = testing::RandomArray(12, 0.2, random);
  for (Eigen::Vector3d& mic : plane) mic.z() = 0.05;
  Listener listener(plane);
  const Eigen::Vector3d below = Eigen::Vector3d(0.6, 0.48, -0.64);
  const Eigen::Vector3d above = Eigen::Vector3d(0.6, 0.48, 0.64);
  const Peaks found = listener.Hear({{below}}, 100.0, random);
  ASSERT_EQ(found.peaks.size(), 1u);
  EXPECT_LT(AngleBetween_deg(found.peaks[0].direction_in_array, above), 0.5);
  const std::vector<float> likelihood = listener.finder().Likelihood(found.peaks);
  const DirectionGrid& grid = listener.grid();
  for (int i = 0; i < grid.size(); ++i) {
    const double angle_deg =
        std::min(AngleBetween_deg(grid[i], above), AngleBetween_deg(grid[i], below));
    if (angle_deg < 2.5) {
      EXPECT_EQ(likelihood[i], 0.9f);
    } else if (angle_deg > 3.5 && angle_deg < 9.5) {
      EXPECT_EQ(likelihood[i], 0.5f);
    } else if (angle_deg > 10.5) {
      EXPECT_EQ(likelihood[i], 0.4f);
    }
  }
}

TEST(PeakLikelihood, DependsOnTheAngleToTheNearestPeak) {
  std::mt19937_64 random(17);
  Listener listener(testing::DomeArray());
  const std::vector<Peak> peaks = {{Eigen::Vector3d::UnitX(), 20.0},
                                   {Eigen::Vector3d(0.6, 0.0, 0.8), 10.0}};
  const std::vector<float> likelihood = listener.finder().Likelihood(peaks);
  const DirectionGrid& grid = listener.grid();
  ASSERT_EQ(static_cast<int>(likelihood.size()), grid.size());
  for (int i = 0; i < grid.size(); ++i) {
    double nearest_deg = 180.0;
    for (const Peak& peak : peaks) {
      nearest_deg = std::min(nearest_deg, AngleBetween_deg(peak.direction_in_array, grid[i]));
    }
    const float expected = nearest_deg <= 3.0 ? 0.9f : nearest_deg <= 10.0 ? 0.5f : 0.4f;
    ASSERT_EQ(likelihood[i], expected) << "direction " << i;
  }
  const auto silent = listener.finder().Likelihood({});
  EXPECT_EQ(silent, std::vector<float>(grid.size(), 0.4f));
}

// By definition over the whole grid, for peaks of all heights above a plane at any rotation.
TEST(PeakLikelihood, NearThePlaneOfAnArrayAllHeightsCountThatItHardlyTellsApart) {
  std::mt19937_64 random(18);
  const Eigen::Quaterniond turn = Eigen::Quaterniond(0.8, 0.3, -0.4, 0.33).normalized();
  Microphones plane = testing::RandomArray(12, 0.2, random);
  for (Eigen::Vector3d& mic : plane) {
    mic.z() = 0.05;
    mic = turn * mic;
  }
  const Eigen::Vector3d normal = turn * Eigen::Vector3d::UnitZ();
  Listener listener(plane, DirectionGrid::EqualArea(geometry::RadFromDeg(2.0)));
  const DirectionGrid& grid = listener.grid();
  // Two directions 3 degrees apart at 45 degrees.
  const double apart = std::sqrt(0.5) * std::sin(geometry::RadFromDeg(3.0));
  for (const double height_deg : {0.0, 2.0, 10.0, 15.0, 25.0, 45.0, 70.0, 90.0}) {
    const double height_rad = geometry::RadFromDeg(height_deg);
    const Eigen::Vector3d peak =
        turn * Eigen::Vector3d(0.6 * std::cos(height_rad), -0.8 * std::cos(height_rad),
                               std::sin(height_rad));
    const std::vector<float> likelihood =
        listener.finder().Likelihood(std::vector<Peak>{{peak, 20.0}});
    double highest_deg = 0.0;
    for (int i = 0; i < grid.size(); ++i) {
      const Eigen::Vector3d above =
          grid[i].dot(normal) < 0.0 ? grid[i] - 2.0 * grid[i].dot(normal) * normal : grid[i];
      const double angle_deg = AngleBetween_deg(above, peak);
      const Eigen::Vector3d off = above - peak;
      const double along = (off - off.dot(normal) * normal).norm();
      if (std::abs(angle_deg - 3.0) < 1e-3 || std::abs(along - apart) < 1e-5) continue;
      const float expected = angle_deg < 3.0 || along < apart ? 0.9f
                             : angle_deg <= 10.0              ? 0.5f
                                                              : 0.4f;
      ASSERT_EQ(likelihood[i], expected) << "direction " << i << " of a peak at " << height_deg;
      if (expected == 0.9f) highest_deg = std::max(highest_deg, angle_deg);
    }
    if (height_deg == 0.0) {
      EXPECT_NEAR(highest_deg, 15.7, 1.5);
    } else if (height_deg >= 45.0) {
      EXPECT_LE(highest_deg, 3.1);
    }
  }
}

}  // namespace
}  // namespace soundmap::acoustics
