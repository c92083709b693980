#include "acoustics/harmonic_srp.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "acoustics/flush_denormals.h"
#include "acoustics/peak_finder.h"
#include "acoustics/ring_grid.h"
#include "acoustics/spherical_harmonics.h"
#include "acoustics/srp_phat.h"
#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

namespace soundmap::acoustics {
namespace {

using geometry::DirectionGrid;
using geometry::kPi;
using geometry::RadFromDeg;
using testing::kSpeedOfSound_mps;
using testing::LiteralPower;
using testing::Microphones;
using testing::RandomDirection;

TEST(SphericalHarmonics, AreThoseOfTheStandardLibrary) {
  constexpr int kDegree = 40;
  for (const double polar_rad : {0.0, 0.01, 0.7, kPi / 2.0, 2.0, kPi}) {
    const std::vector<double> p = NormalizedLegendre(kDegree, std::cos(polar_rad));
    for (int l = 0; l <= kDegree; ++l) {
      for (int m = 0; m <= l; ++m) {
        const double sign = m % 2 == 0 ? 1.0 : -1.0;
        const double factor = m == 0 ? 1.0 : std::sqrt(2.0) * sign;
        EXPECT_NEAR(p[LegendreIndex(l, m)], factor * std::sph_legendre(l, m, polar_rad), 1e-10)
            << l << " " << m;
      }
    }
  }
}

TEST(SphericalHarmonics, BesselFunctionsAreThoseOfTheStandardLibrary) {
  for (const double x : {0.0, 1e-3, 0.5, kPi, 2.0 * kPi, 4.493409457909064, 17.3, 80.0}) {
    for (const int degree : {0, 1, 2, 60}) {
      const std::vector<double> j = SphericalBessel(degree, x);
      for (int l = 0; l <= degree; ++l) {
        EXPECT_NEAR(j[l], std::sph_bessel(l, x), 1e-12) << l << " at " << x;
      }
    }
  }
}

TEST(RingGrid, FindsTheRingsOfTheGridsThatWeMake) {
  const auto equal_area = FindRings(DirectionGrid::EqualArea(RadFromDeg(5.0)));
  ASSERT_TRUE(equal_area.has_value());
  EXPECT_EQ(equal_area->rings.size(), 36u);
  for (const Ring& ring : equal_area->rings) EXPECT_TRUE(ring.circle);
  const auto sector = FindRings(DirectionGrid::Sector(-0.7, 0.2, -0.1, 0.5, 0.02));
  ASSERT_TRUE(sector.has_value());
  EXPECT_EQ(sector->rings.size(), 31u);
  EXPECT_NEAR(sector->centre_azimuth_rad, -0.25, 1e-9);
  std::mt19937_64 random(1);
  EXPECT_FALSE(FindRings(DirectionGrid({RandomDirection(random), RandomDirection(random)}, 0.1)));
}

struct GridCase {
  const char* name;
  DirectionGrid grid;
};

std::vector<GridCase> Grids() {
  return {
      {"the paper's sector", AcousticsConfig::Paper().MakeGrid()},
      {"2 degrees", DirectionGrid::EqualArea(RadFromDeg(2.0))},
      {"1.5 degrees", DirectionGrid::EqualArea(RadFromDeg(1.5))},
      {"circles and poles", DirectionGrid::Sector(-kPi, kPi, -kPi / 2.0, kPi / 2.0, kPi / 60.0)},
      {"odd circles", DirectionGrid::Sector(0.3, 0.3 + 2.0 * kPi, -1.0, 1.4, 2.0 * kPi / 121.0)},
      {"across the back", DirectionGrid::Sector(2.0, 5.0, -0.8, 0.0, 0.024)},
  };
}

// Against eqs. (2)-(5) in double precision: every array, on every grid, in some of the directions.
class HarmonicSrpOracle : public ::testing::TestWithParam<std::tuple<int, bool>> {};

TEST_P(HarmonicSrpOracle, EqualsALiteralTranscriptionInDouble) {
  const auto [count, planar] = GetParam();
  std::mt19937_64 random(10 * count + planar);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  Microphones microphones = testing::RandomArray(count, 0.2, random);
  const Eigen::Matrix3d mounting =
      Eigen::AngleAxisd(planar ? 0.4 : 0.0, RandomDirection(random)).toRotationMatrix();
  for (Eigen::Vector3d& mic : microphones) {
    if (planar) mic.z() = 0.0;
    mic = mounting * mic;
  }
  const auto samples = testing::Record(
      microphones, 16000, layout.scan_samples(),
      {{RandomDirection(random), 1500.0}, {RandomDirection(random), 700.0}}, 300.0, random);
  const auto noise = testing::Record(microphones, 16000, layout.scan_samples(), {}, 300.0, random);
  Stft stft(layout, count);
  const PhatSpectra of_waves = stft.Analyze(samples);
  const PhatSpectra of_noise = stft.Analyze(noise);
  // The hardest of all: one wave alone.
  const PhatSpectra of_one = testing::WaveSpectra(layout, microphones, {0.6, 0.0, 0.8}, random);
  int by_harmonics = 0;
  for (const GridCase& c : Grids()) {
    const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, c.grid).value();
    by_harmonics += srp->by_harmonics();
    for (const PhatSpectra* spectra : {&of_waves, &of_noise, &of_one}) {
      const AudioScan scan = srp->Scan(*spectra);
      ASSERT_EQ(static_cast<int>(scan.power.size()), c.grid.size());
      const int step = c.grid.size() / (count > 16 ? 13 : 60);
      for (int i = static_cast<int>(random() % step); i < c.grid.size(); i += step) {
        const double power = LiteralPower(layout, microphones, *spectra, c.grid[i]);
        ASSERT_NEAR(scan.power[i], power, 1e-5 * layout.bins) << c.name << ", direction " << i;
        ASSERT_NEAR(srp->PowerAt(scan, c.grid[i]), power, 1e-5 * layout.bins) << c.name;
      }
    }
  }
  if (count >= 8) {
    EXPECT_EQ(by_harmonics, static_cast<int>(Grids().size()));
  }
}

INSTANTIATE_TEST_SUITE_P(Arrays, HarmonicSrpOracle,
                         ::testing::Combine(::testing::Values(4, 8, 16, 32, 64), ::testing::Bool()),
                         [](const auto& info) {
                           return std::to_string(std::get<0>(info.param)) +
                                  (std::get<1>(info.param) ? "InAPlane" : "InSpace");
                         });

TEST(SrpPhat, BothWaysHearTheSameInTwentyScenes) {
  std::mt19937_64 random(20);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  for (int scene = 0; scene < 20; ++scene) {
    const int count = 4 + static_cast<int>(random() % 13);
    const Microphones microphones = testing::RandomArray(count, 0.15, random);
    const DirectionGrid grid = DirectionGrid::EqualArea(RadFromDeg(3.0));
    // The same directions in an order without rings.
    std::vector<Eigen::Vector3d> shuffled(grid.begin(), grid.end());
    std::vector<int> place(grid.size());
    std::iota(place.begin(), place.end(), 0);
    std::shuffle(place.begin(), place.end(), random);
    for (int i = 0; i < grid.size(); ++i) shuffled[i] = grid[place[i]];
    const auto by_harmonics = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
    const auto by_look_up =
        SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, DirectionGrid(shuffled, 0.05))
            .value();
    ASSERT_TRUE(by_harmonics->by_harmonics());
    ASSERT_FALSE(by_look_up->by_harmonics());

    std::vector<testing::PlaneWave> waves;
    for (int w = static_cast<int>(random() % 4); w > 0; --w) {
      waves.push_back({RandomDirection(random), 300.0 * w});
    }
    const auto samples =
        testing::Record(microphones, 16000, layout.scan_samples(), waves, 100.0, random);
    const PhatSpectra spectra = Stft(layout, count).Analyze(samples);
    const AudioScan fast = by_harmonics->Scan(spectra);
    const AudioScan plain = by_look_up->Scan(spectra);
    AudioScan plain_in_order = fast;  // its refinement between directions is tested above
    for (int i = 0; i < grid.size(); ++i) {
      ASSERT_NEAR(fast.power[place[i]], plain.power[i], 2e-5 * layout.bins);
      plain_in_order.power[place[i]] = plain.power[i];
    }
    const PeakFinder finder({}, layout, kSpeedOfSound_mps, microphones, by_harmonics);
    const Peaks found = finder.Find(fast);
    const Peaks expected = finder.Find(plain_in_order);
    ASSERT_EQ(found.peaks.size(), expected.peaks.size()) << "scene " << scene;
    EXPECT_NEAR(found.noise_floor, expected.noise_floor, 1e-3);
    for (std::size_t p = 0; p < found.peaks.size(); ++p) {
      EXPECT_NEAR(found.peaks[p].power, expected.peaks[p].power, 1e-3);
      EXPECT_LT(testing::AngleBetween_deg(found.peaks[p].direction_in_array,
                                          expected.peaks[p].direction_in_array),
                0.1);
    }
  }
}

TEST(SrpPhat, AScanInUsedMemoryIsTheSame) {
  std::mt19937_64 random(21);
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  AudioScan used;
  for (const int count : {16, 5, 9}) {
    for (const double spacing_deg : {2.0, 4.0}) {
      const Microphones microphones = testing::RandomArray(count, 0.15, random);
      const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones,
                                       DirectionGrid::EqualArea(RadFromDeg(spacing_deg)))
                           .value();
      const PhatSpectra spectra =
          testing::WaveSpectra(layout, microphones, RandomDirection(random), random);
      srp->Scan(spectra, used);
      const AudioScan fresh = srp->Scan(spectra);
      EXPECT_EQ(used.power, fresh.power);
      EXPECT_EQ(used.harmonics, fresh.harmonics);
    }
  }
}

TEST(FlushDenormals, OnlyWhileItLives) {
  volatile float small = 1e-30f;
  EXPECT_NE(small * 1e-10f, 0.0f);
  {
    const FlushDenormals flush;
    EXPECT_EQ(small * 1e-10f, 0.0f);
  }
  EXPECT_NE(small * 1e-10f, 0.0f);
}

}  // namespace
}  // namespace soundmap::acoustics
