#include "acoustics/beam_pattern.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <complex>

#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

namespace soundmap::acoustics {
namespace {

using geometry::kPi;
using testing::kSpeedOfSound_mps;
using testing::Microphones;
using testing::RandomArray;
using testing::RandomDirection;

// Eqs. (2) to (5) for phasors e^{j w p.s / c}, without pairs: the mean over microphones first.
double LiteralResponse(const FrameLayout& layout, const Microphones& microphones,
                       const Eigen::Vector3d& source, const Eigen::Vector3d& direction) {
  double power = 0.0;
  for (int b = 0; b < layout.bins; ++b) {
    std::complex<double> sum = 0.0;
    for (const Eigen::Vector3d& mic : microphones) {
      sum += std::polar(
          1.0, 2.0 * kPi * layout.bin_hz(b) / kSpeedOfSound_mps * mic.dot(source - direction));
    }
    power += std::norm(sum) / static_cast<double>(microphones.size() * microphones.size());
  }
  return power;
}

struct ArrayCase {
  const char* name;
  int rate_hz;
  int microphones;
  double radius_m;
  Eigen::Vector3d squeeze;  // factor on each axis: planes and lines
  double f_min_hz;
  double f_max_hz;
};

class BeamPatternOracle : public ::testing::TestWithParam<ArrayCase> {};

TEST_P(BeamPatternOracle, IsTheScanOfAUnitWave) {
  const ArrayCase& c = GetParam();
  std::mt19937_64 random(c.rate_hz + c.microphones);
  AcousticsConfig config;
  config.f_min_hz = c.f_min_hz;
  config.f_max_hz = c.f_max_hz;
  const FrameLayout layout = FrameLayout::Create(config, c.rate_hz).value();
  const Eigen::Matrix3d mounting =
      Eigen::AngleAxisd(0.7, RandomDirection(random)).toRotationMatrix();
  Microphones microphones = RandomArray(c.microphones, c.radius_m, random);
  for (Eigen::Vector3d& mic : microphones) mic = mounting * mic.cwiseProduct(c.squeeze);
  const BeamPattern beam(layout, kSpeedOfSound_mps, microphones);
  constexpr int kDirections = 301;
  double squares = 0.0;
  for (int trial = 0; trial < 4; ++trial) {
    const Eigen::Vector3d source =
        trial == 0 ? Eigen::Vector3d(mounting.col(0)) : RandomDirection(random);
    std::vector<Eigen::Vector3d> directions = {source, -source};
    while (directions.size() < kDirections) directions.push_back(RandomDirection(random));
    const BeamPattern::Places places = beam.Prepare(directions);
    ASSERT_EQ(places.size(), kDirections);
    constexpr int kFirst = 1;
    std::vector<float> power(kDirections - kFirst - 2, 1.0f);
    beam.AddResponse(source, 2.0f, 0.5f, places, kFirst, power);
    std::vector<float> plain(power.size(), 1.0f);
    beam.AddResponse(source, 2.0f, 0.5f, places, kFirst, plain, /*plain=*/true);
    EXPECT_EQ(power, plain);
    EXPECT_NEAR(beam.ResponseAt(source, source), layout.bins, BeamPattern::kMaxError * layout.bins);
    for (std::size_t i = 0; i < power.size(); ++i) {
      const Eigen::Vector3d& direction = directions[kFirst + i];
      const double expected = LiteralResponse(layout, microphones, source, direction);
      const double error = beam.ResponseAt(source, direction) - expected;
      ASSERT_NEAR(error, 0.0, BeamPattern::kMaxError * layout.bins);
      ASSERT_NEAR(power[i], 1.0 + 2.0 * (expected - 0.5),
                  2.0 * BeamPattern::kMaxError * layout.bins);
      squares += error * error;
    }
  }
  const double rms = std::sqrt(squares / (4.0 * kDirections));
  EXPECT_LT(rms, 0.5 * BeamPattern::kMaxError * layout.bins);
}

INSTANTIATE_TEST_SUITE_P(
    Arrays, BeamPatternOracle,
    ::testing::Values(ArrayCase{"TwoMicrophones8kHz", 8000, 2, 0.1, {1, 1, 1}, 1000, 3000},
                      ArrayCase{"Line16kHz", 16000, 6, 0.3, {1, 0, 0}, 1000, 3000},
                      ArrayCase{"Plane16kHz", 16000, 8, 0.2, {1, 1, 0}, 1000, 3000},
                      ArrayCase{"Space16kHz", 16000, 16, 0.25, {1, 1, 1}, 1000, 3000},
                      ArrayCase{"Flat16kHz", 16000, 16, 0.25, {1, 1, 0.02}, 1000, 3000},
                      ArrayCase{"WholeBand16kHz", 16000, 5, 0.2, {1, 1, 1}, 0, 8000},
                      ArrayCase{"OneBin16kHz", 16000, 5, 0.2, {1, 1, 1}, 2000, 2000},
                      ArrayCase{"Large44kHz", 44100, 4, 2.0, {1, 1, 1}, 500, 6000},
                      ArrayCase{"Tiny48kHz", 48000, 7, 0.01, {1, 1, 1}, 1000, 3000},
                      ArrayCase{"Ultrasound192kHz", 192000, 4, 0.05, {1, 1, 1}, 20000, 40000},
                      ArrayCase{"SixtyFour16kHz", 16000, 64, 0.4, {1, 1, 1}, 1000, 3000}),
    [](const auto& info) { return info.param.name; });

// Of many pairs with one difference vector each counts.
TEST(BeamPattern, CountsEqualPairsOfARegularArray) {
  std::mt19937_64 random(12);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  Microphones cube;
  for (int corner = 0; corner < 8; ++corner) {
    cube.emplace_back(0.2 * (corner & 1), 0.15 * (corner >> 1 & 1), 0.1 * (corner >> 2));
  }
  const BeamPattern beam(layout, kSpeedOfSound_mps, cube);
  for (int trial = 0; trial < 200; ++trial) {
    const Eigen::Vector3d source = RandomDirection(random);
    const Eigen::Vector3d direction = RandomDirection(random);
    EXPECT_NEAR(beam.ResponseAt(source, direction),
                LiteralResponse(layout, cube, source, direction),
                BeamPattern::kMaxError * layout.bins);
  }
}

TEST(BeamPattern, KnowsWhatTheArrayCannotTellApart) {
  std::mt19937_64 random(8);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  const auto distance = [&](const Microphones& microphones, const Eigen::Vector3d& a,
                            const Eigen::Vector3d& b) {
    const BeamPattern beam(layout, kSpeedOfSound_mps, microphones);
    return testing::AngleBetween_deg(beam.Distinguishable(a), beam.Distinguishable(b));
  };
  Microphones space = RandomArray(6, 0.2, random);
  Microphones plane = space;
  Microphones line = space;
  for (Eigen::Vector3d& mic : plane) mic.y() = 0.3;
  for (Eigen::Vector3d& mic : line) mic = Eigen::Vector3d(0.1, mic.y(), 0.2);
  const Eigen::Vector3d a = Eigen::Vector3d(0.6, 0.64, 0.48);
  const Eigen::Vector3d mirrored = Eigen::Vector3d(0.6, -0.64, 0.48);
  const Eigen::Vector3d turned = Eigen::Vector3d(-0.48, 0.64, 0.6);  // about y
  EXPECT_NEAR(distance(space, a, mirrored), testing::AngleBetween_deg(a, mirrored), 1e-6);
  EXPECT_NEAR(distance(plane, a, mirrored), 0.0, 1e-5);
  EXPECT_NEAR(testing::AngleBetween_deg(
                  BeamPattern(layout, kSpeedOfSound_mps, plane).MirrorImage(a), mirrored),
              0.0, 1e-5);
  EXPECT_NEAR(distance(plane, a, turned), testing::AngleBetween_deg(a, turned), 1e-6);
  EXPECT_NEAR(distance(line, a, turned), 0.0, 1e-5);
  EXPECT_NEAR(distance(line, a, mirrored), testing::AngleBetween_deg(a, mirrored), 1e-5);
}

}  // namespace
}  // namespace soundmap::acoustics
