#include "acoustics/evidence.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>

namespace soundmap::acoustics {
namespace {

// Quartile to median of a normal distribution, in standard deviations.
constexpr double kQuartileInSigmas = 0.6744897501960817;

// A plane wave that has been taken off: gain 1 is a source without any noise.
struct Removed {
  Eigen::Vector3d source;
  double gain;
};

// The power that is left in one direction after the removals.
double ResidualAt(const SrpPhat& srp, const AudioScan& scan, const std::vector<Removed>& removed,
                  const Eigen::Vector3d& direction) {
  const double incoherent = static_cast<double>(srp.band_bins()) / srp.microphones();
  double power = srp.PowerAt(scan, direction);
  for (const Removed& wave : removed) {
    power -= wave.gain * (srp.beam().ResponseAt(wave.source, direction) - incoherent);
  }
  return power;
}

// The maximum near `start`: Newton's steps on quadratics through nine directions.
Eigen::Vector3d ClimbToMaximum(const Eigen::Vector3d& start, double spacing_rad,
                               const std::function<double(const Eigen::Vector3d&)>& power_at) {
  Eigen::Vector3d direction = start;
  for (const double step_rad : {0.5 * spacing_rad, 0.5 * spacing_rad, 0.25 * spacing_rad}) {
    const Eigen::Vector3d east = direction.unitOrthogonal();
    const Eigen::Vector3d north = direction.cross(east);
    Eigen::Matrix3d power;  // by offset along east and north
    for (int e = -1; e <= 1; ++e) {
      for (int n = -1; n <= 1; ++n) {
        power(e + 1, n + 1) =
            power_at((direction + step_rad * (e * east + n * north)).normalized());
      }
    }
    const Eigen::Vector2d gradient(power(2, 1) - power(0, 1), power(1, 2) - power(1, 0));
    Eigen::Matrix2d curvature;
    curvature(0, 0) = power(2, 1) - 2.0 * power(1, 1) + power(0, 1);
    curvature(1, 1) = power(1, 2) - 2.0 * power(1, 1) + power(1, 0);
    curvature(0, 1) = curvature(1, 0) =
        0.25 * (power(2, 2) - power(2, 0) - power(0, 2) + power(0, 0));
    if (gradient.norm() == 0.0) break;
    const bool maximum = curvature(0, 0) < 0.0 && curvature.determinant() > 0.0;
    Eigen::Vector2d steps =
        maximum ? Eigen::Vector2d(-0.5 * curvature.inverse() * gradient) : gradient.normalized();
    constexpr double kMaxSteps = 1.5;
    if (steps.norm() > kMaxSteps) steps *= kMaxSteps / steps.norm();
    direction = (direction + step_rad * (steps[0] * east + steps[1] * north)).normalized();
  }
  return direction;
}

bool Covers(const geometry::DirectionGrid& grid, const Eigen::Vector3d& direction) {
  const double near = std::cos(grid.spacing_rad());
  return std::any_of(grid.begin(), grid.end(), [&](const Eigen::Vector3d& candidate) {
    return candidate.dot(direction) > near;
  });
}

struct Background {
  double floor;
  double spread;
};

// Of the directions in the sample.
Background BackgroundOf(const SrpPhat& srp, const std::vector<float>& power) {
  std::vector<float> sample;
  sample.reserve(power.size());
  for (int i = 0; i < static_cast<int>(power.size()); ++i) {
    if (srp.beam().InSample(i)) sample.push_back(power[i]);
  }
  const auto at = [&](std::size_t rank) {
    return sample.begin() + static_cast<std::ptrdiff_t>(rank);
  };
  const std::size_t middle = (sample.size() - 1) / 2;
  std::nth_element(sample.begin(), at(middle), sample.end());
  const double median = *at(middle);
  const std::size_t quarter = (sample.size() - 1) / 4;
  std::nth_element(sample.begin(), at(quarter), at(middle));
  return {median, (median - *at(quarter)) / kQuartileInSigmas};
}

}  // namespace

std::vector<float> DoubleThresholdLikelihood(std::span<const float> power,
                                             const DoubleThreshold& evidence) {
  std::vector<float> likelihood(power.size());
  for (std::size_t i = 0; i < power.size(); ++i) {
    likelihood[i] = static_cast<float>(power[i] < evidence.t1   ? evidence.p_min
                                       : power[i] > evidence.t2 ? evidence.p_max
                                                                : evidence.p_med);
  }
  return likelihood;
}

Peaks FindPeaks(const SrpPhat& srp, const AudioScan& scan, const PeakEvidence& evidence) {
  const double incoherent = static_cast<double>(srp.band_bins()) / srp.microphones();
  const double least_height = evidence.threshold_incoherent_spreads * srp.beam().IncoherentSpread();
  const geometry::DirectionGrid& grid = srp.grid();
  Peaks found;
  std::vector<float> residual = scan.power;
  std::vector<float> without_peak = scan.power;  // kept up for the sample alone
  Background background = BackgroundOf(srp, residual);
  std::vector<Removed> removed;
  while (static_cast<int>(removed.size()) < evidence.max_peaks) {
    const auto largest = std::max_element(residual.begin(), residual.end());
    if (!(*largest > background.floor + least_height)) break;
    const Eigen::Vector3d& start = grid[static_cast<int>(largest - residual.begin())];
    Eigen::Vector3d direction =
        ClimbToMaximum(start, grid.spacing_rad(),
                       [&](const Eigen::Vector3d& u) { return ResidualAt(srp, scan, removed, u); });
    const double power = std::max<double>(*largest, ResidualAt(srp, scan, removed, direction));
    // What is not a plane wave has the power of incoherent noise or more. The median can lie below,
    // among the side lobes of the peak.
    const double gain =
        (power - std::max(background.floor, incoherent)) / (srp.band_bins() - incoherent);
    const auto offset = static_cast<float>(incoherent);
    // The peak must stand out of what is left without it: its own side lobes are no noise.
    srp.beam().AddResponseToSample(direction, static_cast<float>(-gain), offset, without_peak);
    const Background rest = BackgroundOf(srp, without_peak);
    if (!(power > rest.floor + std::max(evidence.threshold_spreads * rest.spread, least_height))) {
      break;
    }
    background = rest;
    removed.push_back({direction, gain});
    srp.beam().AddResponse(direction, static_cast<float>(-gain), offset, residual);
    const bool moved_off = start.dot(direction) < std::cos(grid.spacing_rad());
    if (moved_off && !Covers(grid, direction)) continue;
    if (srp.beam().array_rank() == 2) {
      // Both images are equally true; one side is reported, so that a source does not jump between
      // them.
      const Eigen::Vector3d image = srp.beam().Distinguishable(direction);
      if (Covers(grid, image)) direction = image;
    }
    found.peaks.push_back({direction, power});
  }
  found.noise_floor = background.floor;
  found.spread = background.spread;
  std::stable_sort(found.peaks.begin(), found.peaks.end(),
                   [](const Peak& a, const Peak& b) { return a.power > b.power; });
  return found;
}

std::vector<float> PeakLikelihood(const SrpPhat& srp, std::span<const Peak> peaks,
                                  const PeakEvidence& evidence) {
  const geometry::DirectionGrid& grid = srp.grid();
  std::vector<float> likelihood(grid.size(), static_cast<float>(evidence.p_rest));
  if (peaks.empty()) return likelihood;
  std::vector<Eigen::Vector3d> image;
  for (const Peak& peak : peaks)
    image.push_back(srp.beam().Distinguishable(peak.direction_in_array));
  const double peak_cosine = std::cos(evidence.peak_radius_rad);
  const double undecided_cosine = std::cos(evidence.undecided_radius_rad);
  for (int i = 0; i < grid.size(); ++i) {
    const Eigen::Vector3d candidate = srp.beam().Distinguishable(grid[i]);
    double nearest = -1.0;
    for (const Eigen::Vector3d& peak : image) nearest = std::max(nearest, peak.dot(candidate));
    if (nearest >= peak_cosine) {
      likelihood[i] = static_cast<float>(evidence.p_peak);
    } else if (nearest >= undecided_cosine) {
      likelihood[i] = static_cast<float>(evidence.p_undecided);
    }
  }
  return likelihood;
}

}  // namespace soundmap::acoustics
