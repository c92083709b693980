#include "acoustics/peak_finder.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <complex>
#include <string>

#include "geometry/angles.h"
#include "tests/acoustics/plane_waves.h"

// The peaks against peak removal as it is described: every direction of the grid, every response
// by eqs. (2) to (5), all in double precision.
namespace soundmap::acoustics {
namespace {

using geometry::DirectionGrid;
using geometry::kPi;
using testing::AngleBetween_deg;
using testing::kSpeedOfSound_mps;
using testing::Microphones;
using testing::RandomDirection;

class PlainPeaks {
 public:
  PlainPeaks(const FrameLayout& layout, const Microphones& microphones, const SrpPhat& srp,
             std::vector<int> sample)
      : layout_(layout), microphones_(microphones), srp_(srp), sample_(std::move(sample)) {}

  Peaks Find(const AudioScan& scan, const PeakEvidence& evidence, double spread_of_noise) const {
    const DirectionGrid& grid = srp_.grid();
    const double incoherent = static_cast<double>(layout_.bins) / microphones_.size();
    const double least_height = evidence.threshold_incoherent_spreads * spread_of_noise;
    std::vector<double> residual(scan.power.begin(), scan.power.end());
    std::vector<Wave> removed;
    Peaks found;
    double noise_floor = Background(residual).first;
    while (static_cast<int>(removed.size()) < evidence.max_peaks) {
      const auto largest = std::max_element(residual.begin(), residual.end());
      if (!(*largest > noise_floor + least_height)) break;
      const Eigen::Vector3d direction = Climb(scan, removed, grid[largest - residual.begin()]);
      const double power = std::max(*largest, ResidualAt(scan, removed, direction));
      const double gain = (power - std::max(noise_floor, incoherent)) / (layout_.bins - incoherent);
      std::vector<double> rest = residual;
      for (int i = 0; i < grid.size(); ++i) {
        rest[i] -= gain * (Response(direction, grid[i]) - incoherent);
      }
      const auto [floor, spread] = Background(rest);
      if (!(power > floor + std::max(evidence.threshold_spreads * spread, least_height))) break;
      noise_floor = floor;
      residual = std::move(rest);
      removed.push_back({direction, gain});
      found.peaks.push_back({direction, power});
    }
    std::stable_sort(found.peaks.begin(), found.peaks.end(),
                     [](const Peak& a, const Peak& b) { return a.power > b.power; });
    std::vector<Eigen::Vector3d> strong;
    for (const Peak& peak : found.peaks) strong.push_back(peak.direction_in_array);
    AudioScan rest;
    srp_.Without(scan, strong, rest);
    residual.assign(rest.power.begin(), rest.power.end());
    std::tie(found.noise_floor, found.spread) = Background(residual);
    return found;
  }

 private:
  struct Wave {
    Eigen::Vector3d source;
    double gain;
  };

  double Response(const Eigen::Vector3d& source, const Eigen::Vector3d& direction) const {
    std::vector<std::complex<double>> sum(layout_.bins);
    for (const Eigen::Vector3d& mic : microphones_) {
      const double delay_s = mic.dot(source - direction) / kSpeedOfSound_mps;
      const auto turn =
          std::polar(1.0, 2.0 * kPi * (layout_.bin_hz(1) - layout_.bin_hz(0)) * delay_s);
      auto phasor = std::polar(1.0, 2.0 * kPi * layout_.bin_hz(0) * delay_s);
      for (int b = 0; b < layout_.bins; ++b, phasor *= turn) sum[b] += phasor;
    }
    double power = 0.0;
    for (const std::complex<double>& s : sum) power += std::norm(s);
    return power / static_cast<double>(microphones_.size() * microphones_.size());
  }

  double ResidualAt(const AudioScan& scan, const std::vector<Wave>& removed,
                    const Eigen::Vector3d& direction) const {
    double power = srp_.PowerAt(scan, direction);
    for (const Wave& wave : removed) {
      power -= wave.gain * (Response(wave.source, direction) -
                            static_cast<double>(layout_.bins) / microphones_.size());
    }
    return power;
  }

  // The nearest maximum, uphill in steps that become shorter.
  Eigen::Vector3d Climb(const AudioScan& scan, const std::vector<Wave>& removed,
                        const Eigen::Vector3d& start) const {
    Eigen::Vector3d direction = start;
    double power = ResidualAt(scan, removed, direction);
    for (double step_rad = 0.5 * srp_.grid().spacing_rad(); step_rad > 1e-5;) {
      const Eigen::Vector3d east = direction.unitOrthogonal();
      const Eigen::Vector3d north = direction.cross(east);
      Eigen::Vector3d best = direction;
      for (int k = 0; k < 8; ++k) {
        const Eigen::Vector3d next = (direction + step_rad * (std::cos(k * kPi / 4.0) * east +
                                                              std::sin(k * kPi / 4.0) * north))
                                         .normalized();
        const double there = ResidualAt(scan, removed, next);
        if (there > power) {
          power = there;
          best = next;
        }
      }
      if (best == direction) step_rad *= 0.5;
      direction = best;
    }
    return direction;
  }

  std::pair<double, double> Background(const std::vector<double>& residual) const {
    std::vector<double> sorted;
    for (const int i : sample_) sorted.push_back(residual[i]);
    std::sort(sorted.begin(), sorted.end());
    const double median = sorted[(sorted.size() - 1) / 2];
    return {median, (median - sorted[(sorted.size() - 1) / 4]) / 0.6744897501960817};
  }

  const FrameLayout& layout_;
  const Microphones& microphones_;
  const SrpPhat& srp_;
  std::vector<int> sample_;
};

// Every direction that no other within 5 degrees surpasses, 2.5 spreads or more above the median.
std::vector<int> PlainMaxima(const AudioScan& scan, const DirectionGrid& grid,
                             const std::vector<int>& sample) {
  std::vector<double> sorted;
  for (const int i : sample) sorted.push_back(scan.power[i]);
  std::sort(sorted.begin(), sorted.end());
  const double median = sorted[(sorted.size() - 1) / 2];
  const double spread = (median - sorted[(sorted.size() - 1) / 4]) / 0.6744897501960817;
  std::vector<int> maxima;
  for (int i = 0; i < grid.size(); ++i) {
    bool largest = scan.power[i] > median + 2.5 * spread;
    for (int j = 0; j < grid.size() && largest; ++j) {
      largest = scan.power[j] <= scan.power[i] || AngleBetween_deg(grid[i], grid[j]) > 5.0;
    }
    if (largest) maxima.push_back(i);
  }
  return maxima;
}

// Random arrays from 4 to 64 microphones, in a plane or in space; one to four waves, weak ones
// beside strong ones.
TEST(PeakFinder, FindsWhatPlainPeakRemovalFinds) {
  const DirectionGrid grid = DirectionGrid::EqualArea(geometry::RadFromDeg(3.0));
  // Directions near the plane of an array are hardly determined in a wider band.
  AcousticsConfig config;
  config.f_max_hz = 3000.0;
  const FrameLayout layout = FrameLayout::Create(config, 16000).value();
  PeakEvidence evidence;
  evidence.faint_spreads = 1e3;
  int peaks = 0;
  for (int scene = 0; scene < 24; ++scene) {
    SCOPED_TRACE("scene " + std::to_string(scene));
    std::mt19937_64 random(100 + scene);
    const int count = scene % 6 == 5 ? 64 : 4 + 3 * (scene % 6) + scene / 6;
    Microphones microphones = testing::RandomArray(count, 0.1 + 0.02 * (scene % 5), random);
    const bool plane = scene % 2 == 1;
    if (plane) {
      for (Eigen::Vector3d& mic : microphones) mic.z() = 0.1;
    }
    const std::shared_ptr<const SrpPhat> srp =
        SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
    const PeakFinder finder(evidence, layout, kSpeedOfSound_mps, microphones, srp);
    std::vector<testing::PlaneWave> waves;
    for (int w = 0; w <= scene % 4; ++w) {
      waves.push_back({RandomDirection(random), 2000.0 * std::pow(10.0, -4.0 * w / 20.0)});
    }
    const auto samples =
        testing::Record(microphones, 16000, layout.scan_samples(), waves, 100.0, random);
    const AudioScan scan = srp->Scan(Stft(layout, count).Analyze(samples));
    const Peaks found = finder.Find(scan);
    const Peaks expected = PlainPeaks(layout, microphones, *srp, finder.sample())
                               .Find(scan, evidence, finder.beam().IncoherentSpread());
    std::vector<Eigen::Vector3d> strong;
    for (const Peak& peak : found.peaks) strong.push_back(peak.direction_in_array);
    AudioScan rest;
    srp->Without(scan, strong, rest);
    std::vector<int> maxima = PlainMaxima(scan, grid, finder.sample());
    for (const int i : PlainMaxima(rest, grid, finder.sample())) maxima.push_back(i);
    std::sort(maxima.begin(), maxima.end());
    maxima.erase(std::unique(maxima.begin(), maxima.end()), maxima.end());
    EXPECT_EQ(found.maxima, maxima);
    ASSERT_EQ(found.peaks.size(), expected.peaks.size());
    EXPECT_NEAR(found.noise_floor, expected.noise_floor, 1e-3 * layout.bins);
    EXPECT_NEAR(found.spread, expected.spread, 1e-3 * layout.bins);
    for (std::size_t p = 0; p < found.peaks.size(); ++p, ++peaks) {
      const Eigen::Vector3d direction =
          plane ? finder.beam().Distinguishable(expected.peaks[p].direction_in_array)
                : expected.peaks[p].direction_in_array;
      EXPECT_LT(AngleBetween_deg(found.peaks[p].direction_in_array, direction), 0.75)
          << found.peaks[p].direction_in_array.transpose() << " and " << direction.transpose();
      EXPECT_NEAR(found.peaks[p].power, expected.peaks[p].power, 1e-3 * layout.bins);
    }
  }
  EXPECT_GT(peaks, 40);
}

// A hiss fills the upper half of the band. Its side lobes, narrower than the beam's mean over the
// band has them, hide nothing once it is taken off bin by bin.
TEST(PeakFinder, HearsAFaintSourceBesideALoudOneOfAnotherSpectrum) {
  const DirectionGrid grid = DirectionGrid::EqualArea(geometry::RadFromDeg(3.0));
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  constexpr int kMicrophones = 8;
  constexpr int kScans = 60;
  std::mt19937_64 random(21);
  std::normal_distribution<double> normal;
  const auto amplitude = [&](double rms) {
    return rms * std::complex<double>(normal(random), normal(random));
  };
  const Microphones microphones = testing::RandomArray(kMicrophones, 0.15, random);
  const auto srp = SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
  const PeakFinder finder({}, layout, kSpeedOfSound_mps, microphones, srp);
  int heard = 0;
  for (int scan = 0; scan < kScans; ++scan) {
    const Eigen::Vector3d loud = RandomDirection(random);
    Eigen::Vector3d faint = RandomDirection(random);
    while (AngleBetween_deg(loud, faint) < 60.0) faint = RandomDirection(random);
    PhatSpectra spectra(layout.frames_per_scan, kMicrophones, layout.bins);
    for (int t = 0; t < spectra.frames; ++t) {
      for (int b = 0; b < layout.bins; ++b) {
        const std::complex<double> hiss = amplitude(2 * b < layout.bins ? 0.0 : 1.0);
        const std::complex<double> hum = amplitude(0.10);
        const double wave_number = 2.0 * kPi * layout.bin_hz(b) / kSpeedOfSound_mps;
        for (int n = 0; n < kMicrophones; ++n) {
          std::complex<double> sound =
              hiss * std::polar(1.0, wave_number * microphones[n].dot(loud)) +
              hum * std::polar(1.0, wave_number * microphones[n].dot(faint)) + amplitude(0.25);
          sound /= std::abs(sound);
          spectra.real[spectra.index(t, n, b)] = static_cast<float>(sound.real());
          spectra.imaginary[spectra.index(t, n, b)] = static_cast<float>(sound.imag());
        }
      }
    }
    const Peaks found = finder.Find(srp->Scan(spectra));
    heard += std::any_of(found.peaks.begin(), found.peaks.end(), [&](const Peak& peak) {
      return AngleBetween_deg(peak.direction_in_array, faint) < 6.0;
    });
  }
  EXPECT_GE(heard, 57);  // with the beam's mean over the band alone: 3
}

// A source too faint for a single scan's certainty is heard in many scans all the same, from one
// direction; noise puts a faint peak there in hardly any.
TEST(PeakFinder, FaintPeaksComeFromFaintSourcesAgainAndAgain) {
  const DirectionGrid grid = DirectionGrid::EqualArea(geometry::RadFromDeg(3.0));
  const FrameLayout layout = FrameLayout::Create({}, 16000).value();
  std::mt19937_64 random(9);
  const Microphones microphones = testing::RandomArray(8, 0.15, random);
  const std::shared_ptr<const SrpPhat> srp =
      SrpPhat::Create(layout, kSpeedOfSound_mps, microphones, grid).value();
  PeakEvidence certain;
  certain.faint_spreads = 1e3;
  const PeakFinder with_faint({}, layout, kSpeedOfSound_mps, microphones, srp);
  const PeakFinder without(certain, layout, kSpeedOfSound_mps, microphones, srp);
  const Eigen::Vector3d strong = RandomDirection(random);
  Eigen::Vector3d faint = strong;
  while (AngleBetween_deg(strong, faint) < 60.0) faint = RandomDirection(random);
  const Eigen::Vector3d elsewhere = -(strong + faint).normalized();
  Stft stft(layout, 8);
  int heard = 0, heard_without = 0, ghosts = 0;
  constexpr int kScans = 40;
  for (int k = 0; k < kScans; ++k) {
    const auto samples = testing::Record(microphones, 16000, layout.scan_samples(),
                                         {{strong, 2000.0}, {faint, 360.0}}, 1000.0, random);
    const AudioScan scan = srp->Scan(stft.Analyze(samples));
    const auto near = [](const Peaks& found, const Eigen::Vector3d& direction) {
      return std::any_of(found.peaks.begin(), found.peaks.end(), [&](const Peak& peak) {
        return AngleBetween_deg(peak.direction_in_array, direction) < 5.0;
      });
    };
    const Peaks found = with_faint.Find(scan);
    EXPECT_TRUE(near(found, strong));
    EXPECT_LE(found.peaks.size(), 10u);
    heard += near(found, faint);
    ghosts += near(found, elsewhere);
    heard_without += near(without.Find(scan), faint);
  }
  EXPECT_GT(heard, kScans / 4);
  EXPECT_GT(heard, heard_without + kScans / 8);
  EXPECT_LE(ghosts, kScans / 20);
}

}  // namespace
}  // namespace soundmap::acoustics
