#include "acoustics/srp_phat.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>

#include "acoustics/beam_pattern.h"
#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

namespace soundmap::acoustics {
namespace {

using geometry::DirectionGrid;
using geometry::kPi;
using testing::kSpeedOfSound_mps;
using testing::LiteralPower;
using testing::Microphones;
using testing::RandomArray;
using testing::RandomDirection;

DirectionGrid RandomGrid(int count, std::mt19937_64& random) {
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < count; ++i) directions.push_back(RandomDirection(random));
  return DirectionGrid(directions, 0.1);
}

int IndexOfMax(const std::vector<float>& power) {
  return static_cast<int>(std::max_element(power.begin(), power.end()) - power.begin());
}

// The definition of Without() in double, bin by bin, one wave after the other: the mean over the
// microphone pairs of their cross-spectra, turned back to the direction, is the wave's power, if it
// is positive; its cross-spectra are taken off.
class LiteralRest {
 public:
  LiteralRest(const FrameLayout& layout, const Microphones& microphones, const PhatSpectra& spectra,
              const std::vector<Eigen::Vector3d>& sources)
      : layout_(layout), microphones_(microphones) {
    const auto count = static_cast<Eigen::Index>(microphones.size());
    for (int b = 0; b < layout.bins; ++b) {
      Eigen::MatrixXcd cross = Eigen::MatrixXcd::Zero(count, count);  // mean over the frames
      for (int t = 0; t < spectra.frames; ++t) {
        Eigen::VectorXcd v(count);
        for (int n = 0; n < count; ++n) {
          v[n] = {spectra.real[spectra.index(t, n, b)], spectra.imaginary[spectra.index(t, n, b)]};
        }
        cross += v * v.adjoint() / static_cast<double>(spectra.frames);
      }
      for (const Eigen::Vector3d& source : sources) {
        const Eigen::VectorXcd wave = Wave(b, source);
        const double of_pairs = wave.dot(cross * wave).real() - cross.trace().real();
        Eigen::MatrixXcd of_wave = wave * wave.adjoint();
        of_wave.diagonal().setZero();
        cross -= std::max(0.0, of_pairs) / (count * (count - 1.0)) * of_wave;
      }
      cross_.push_back(cross);
    }
  }

  double PowerAt(const Eigen::Vector3d& direction) const {
    double power = 0.0;
    for (int b = 0; b < layout_.bins; ++b) {
      const Eigen::VectorXcd wave = Wave(b, direction);
      power += wave.dot(cross_[b] * wave).real() / (wave.squaredNorm() * wave.squaredNorm());
    }
    return power;
  }

 private:
  Eigen::VectorXcd Wave(int b, const Eigen::Vector3d& direction) const {
    Eigen::VectorXcd wave(static_cast<Eigen::Index>(microphones_.size()));
    for (std::size_t n = 0; n < microphones_.size(); ++n) {
      const double delay_s = microphones_[n].dot(direction) / kSpeedOfSound_mps;
      wave[static_cast<Eigen::Index>(n)] = std::polar(1.0, 2.0 * kPi * layout_.bin_hz(b) * delay_s);
    }
    return wave;
  }

  const FrameLayout& layout_;
  const Microphones& microphones_;
  std::vector<Eigen::MatrixXcd> cross_;
};

struct OracleCase {
  const char* name;
  int rate_hz;
  int microphones;
  double radius_m;
  Eigen::Vector3d squeeze;  // factor on each axis: planes and lines
  int frames;
  double f_min_hz;
  double f_max_hz;
};

class SrpPhatOracle : public ::testing::TestWithParam<OracleCase> {
 protected:
  SrpPhatOracle() : random(GetParam().rate_hz + GetParam().microphones) {
    const OracleCase& c = GetParam();
    AcousticsConfig config;
    config.frames_per_scan = c.frames;
    config.f_min_hz = c.f_min_hz;
    config.f_max_hz = c.f_max_hz;
    layout = FrameLayout::Create(config, c.rate_hz).value();
    microphones = RandomArray(c.microphones, c.radius_m, random);
    const Eigen::Matrix3d mounting =
        Eigen::AngleAxisd(0.7, RandomDirection(random)).toRotationMatrix();
    for (Eigen::Vector3d& mic : microphones) mic = mounting * mic.cwiseProduct(c.squeeze);
    sources = {RandomDirection(random), RandomDirection(random)};
    samples = testing::Record(microphones, c.rate_hz, layout.scan_samples(),
                              {{sources[0], 1500.0}, {sources[1], 700.0}}, 300.0, random);
  }

  std::mt19937_64 random;
  FrameLayout layout;
  Microphones microphones;
  std::vector<Eigen::Vector3d> sources;
  std::vector<std::int16_t> samples;
};

TEST_P(SrpPhatOracle, EqualsALiteralTranscriptionInDouble) {
  const OracleCase& c = GetParam();
  const testing::LiteralSpectra literal = testing::LiteralPhat(layout, c.microphones, samples);
  Stft stft(layout, c.microphones);
  // Without rings and with them.
  for (const DirectionGrid& grid :
       {RandomGrid(150, random), DirectionGrid::EqualArea(geometry::RadFromDeg(10.0))}) {
    const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
    const AudioScan scan = srp->Scan(stft.Analyze(samples));
    for (int i = 0; i < grid.size(); i += 1 + grid.size() / 150) {
      const double power = LiteralPower(layout, microphones, literal, grid[i]);
      ASSERT_NEAR(scan.power[i], power, 1e-5 * layout.bins) << "direction " << i;
      ASSERT_NEAR(srp->PowerAt(scan, grid[i]), power, 1e-5 * layout.bins) << "direction " << i;
      ASSERT_GE(scan.power[i], -1e-5 * layout.bins);
    }
  }
}

TEST_P(SrpPhatOracle, WithoutWavesEqualsTheDefinitionInDouble) {
  const PhatSpectra spectra = Stft(layout, GetParam().microphones).Analyze(samples);
  const LiteralRest expected(layout, microphones, spectra, sources);
  for (const DirectionGrid& grid :
       {RandomGrid(50, random), DirectionGrid::EqualArea(geometry::RadFromDeg(20.0))}) {
    const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
    const AudioScan scan = srp->Scan(spectra);
    AudioScan rest;
    srp->Without(scan, sources, rest);
    for (int i = 0; i < grid.size(); i += 1 + grid.size() / 50) {
      const double power = expected.PowerAt(grid[i]);
      ASSERT_NEAR(rest.power[i], power, 2e-5 * layout.bins) << "direction " << i;
      ASSERT_NEAR(srp->PowerAt(rest, grid[i]), power, 2e-5 * layout.bins) << "direction " << i;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(
    Arrays, SrpPhatOracle,
    ::testing::Values(OracleCase{"TwoMicrophones8kHz", 8000, 2, 0.1, {1, 1, 1}, 10, 1000, 3000},
                      OracleCase{"Line16kHz", 16000, 6, 0.3, {1, 0, 0}, 10, 1000, 3000},
                      OracleCase{"Plane16kHz", 16000, 8, 0.2, {1, 1, 0}, 10, 1000, 3000},
                      OracleCase{"Space16kHz", 16000, 16, 0.25, {1, 1, 1}, 10, 1000, 3000},
                      OracleCase{"WholeBand16kHz", 16000, 5, 0.2, {1, 1, 1}, 4, 0, 8000},
                      OracleCase{"OneBin16kHz", 16000, 5, 0.2, {1, 1, 1}, 10, 2000, 2000},
                      OracleCase{"Large44kHz", 44100, 4, 2.0, {1, 1, 1}, 3, 500, 6000},
                      OracleCase{"Tiny48kHz", 48000, 7, 0.01, {1, 1, 1}, 3, 1000, 3000},
                      OracleCase{"Ultrasound192kHz", 192000, 4, 0.05, {1, 1, 1}, 2, 20000, 40000},
                      OracleCase{"SixtyFour16kHz", 16000, 64, 0.4, {1, 1, 1}, 3, 1000, 3000}),
    [](const auto& info) { return info.param.name; });

TEST(SrpPhat, EqualDifferenceVectorsAreMergedExactly) {
  // A cube: 28 pairs, 13 difference vectors.
  Microphones cube;
  for (int n = 0; n < 8; ++n) cube.emplace_back(0.1 * (n & 1), 0.1 * (n >> 1 & 1), 0.1 * (n >> 2));
  std::mt19937_64 random(3);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  const DirectionGrid grid = RandomGrid(100, random);
  const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, cube, grid).value();
  const auto samples = testing::Record(cube, 16000, layout.scan_samples(),
                                       {{RandomDirection(random)}}, 800.0, random);
  const PhatSpectra spectra = Stft(layout, 8).Analyze(samples);
  const AudioScan scan = srp->Scan(spectra);
  const std::vector<Eigen::Vector3d> sources = {RandomDirection(random)};
  const LiteralRest expected(layout, cube, spectra, sources);
  AudioScan rest;
  srp->Without(scan, sources, rest);
  for (int i = 0; i < grid.size(); ++i) {
    EXPECT_NEAR(scan.power[i], LiteralPower(layout, cube, spectra, grid[i]), 1e-5 * layout.bins);
    EXPECT_NEAR(rest.power[i], expected.PowerAt(grid[i]), 2e-5 * layout.bins);
  }
}

TEST(SrpPhat, APlaneWaveReachesTheBoundInItsOwnDirection) {
  std::mt19937_64 random(4);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  const DirectionGrid grid = DirectionGrid::EqualArea(geometry::RadFromDeg(4.0));
  for (int trial = 0; trial < 20; ++trial) {
    const int count = 7 + 3 * trial;
    const Microphones microphones = RandomArray(count, 0.2, random);
    const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
    const int source = static_cast<int>(random() % grid.size());
    const AudioScan scan =
        srp->Scan(testing::WaveSpectra(layout, microphones, grid[source], random));
    EXPECT_NEAR(scan.power[source], layout.bins, 1e-3);
    EXPECT_EQ(IndexOfMax(scan.power), source);
    EXPECT_LT(*std::max_element(scan.power.begin(), scan.power.end()), layout.bins + 1e-3);
    // Between the grid's directions.
    const Eigen::Vector3d off_grid = RandomDirection(random);
    const AudioScan other = srp->Scan(testing::WaveSpectra(layout, microphones, off_grid, random));
    EXPECT_NEAR(srp->PowerAt(other, off_grid), layout.bins, 1e-3);
    EXPECT_LT(testing::AngleBetween_deg(grid[IndexOfMax(other.power)], off_grid), 4.0);
  }
}

TEST(SrpPhat, TheAntipodeOfASourceIsNoPeak) {
  std::mt19937_64 random(5);
  const Microphones microphones = testing::DomeArray();
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  const Eigen::Vector3d source = Eigen::Vector3d(0.6, 0.48, 0.64);
  const DirectionGrid grid({source, -source}, 0.1);
  const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
  const auto samples =
      testing::Record(microphones, 16000, layout.scan_samples(), {{source}}, 1.0, random);
  const AudioScan scan = srp->Scan(Stft(layout, 16).Analyze(samples));
  EXPECT_GT(scan.power[0], 0.95 * layout.bins);
  EXPECT_LT(scan.power[1], 0.3 * layout.bins);
}

TEST(SrpPhat, IncoherentNoiseAveragesBandBinsOverMicrophones) {
  std::mt19937_64 random(6);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  const DirectionGrid grid = DirectionGrid::EqualArea(geometry::RadFromDeg(20.0));
  for (const int count : {2, 8, 16}) {
    const Microphones microphones = RandomArray(count, 0.2, random);
    const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
    Stft stft(layout, count);
    constexpr int kScans = 300;
    double sum = 0.0;
    double squares = 0.0;
    for (int k = 0; k < kScans; ++k) {
      const auto samples =
          testing::Record(microphones, 16000, layout.scan_samples(), {}, 500.0, random);
      const AudioScan scan = srp->Scan(stft.Analyze(samples));
      for (const float power : scan.power) {
        const double excess = power - static_cast<double>(layout.bins) / count;
        sum += excess;
        squares += excess * excess;
      }
    }
    const double values = static_cast<double>(kScans) * grid.size();
    EXPECT_NEAR(sum / values, 0.0, 0.01 * layout.bins / count);
    EXPECT_NEAR(std::sqrt(squares / values) /
                    BeamPattern(layout, kSpeedOfSound_mps, microphones).IncoherentSpread(),
                1.0, 0.1);
  }
}

TEST(SrpPhat, RefusesWhatIsNoArray) {
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  const DirectionGrid grid({Eigen::Vector3d::UnitX()}, 0.1);
  const auto message = [&](const Microphones& microphones) {
    return std::string(
        SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).status().message());
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(message({{0, 0, 0}}).find("1 microphone"), std::string::npos);
  EXPECT_NE(message(Microphones(65, Eigen::Vector3d::Zero())).find("65 microphone"),
            std::string::npos);
  EXPECT_NE(message({{0, 0, 0}, {nan, 0, 0}}).find("mic_1 is not finite"), std::string::npos);
  EXPECT_NE(message({{0, 0, 1}, {0, 0, 0}, {0, 0, 1}}).find("mic_0 and mic_2"), std::string::npos);
  EXPECT_NE(message({{0, 0, 0}, {1e9, 0, 0}}).find("too large"), std::string::npos);
  EXPECT_FALSE(
      SrpPhat::Create(layout, kSpeedOfSound_mps, {{0, 0, 0}, {1, 0, 0}}, DirectionGrid({}, 0.1))
          .ok());
}

}  // namespace
}  // namespace soundmap::acoustics
