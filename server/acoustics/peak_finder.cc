#include "acoustics/peak_finder.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>

#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

// Quartile to median of a normal distribution, in standard deviations.
constexpr double kQuartileInSigmas = 0.6744897501960817;

// Cells are so small that the power cannot fall from a maximum of the grid to less than half of it
// (above the noise floor) at the centre of the maximum's cell.
constexpr double kCellsPerResolution = 2.5;
constexpr double kLeastAtCentre = 0.5;

// Peaks::maxima.
constexpr double kMaximumSpreads = 2.5;
const double kMaximumRadius_rad = geometry::RadFromDeg(5.0);

std::vector<Eigen::Vector3d> Pick(const geometry::DirectionGrid& grid, std::span<const int> which) {
  std::vector<Eigen::Vector3d> directions;
  directions.reserve(which.size());
  for (const int i : which) directions.push_back(grid[i]);
  return directions;
}

}  // namespace

PeakFinder::PeakFinder(const PeakEvidence& evidence, const FrameLayout& layout,
                       double speed_of_sound_mps,
                       const std::vector<Eigen::Vector3d>& mic_in_array_m,
                       std::shared_ptr<const SrpPhat> srp)
    : evidence_(evidence),
      srp_(std::move(srp)),
      beam_(layout, speed_of_sound_mps, mic_in_array_m),
      cells_(srp_->grid(), beam_.resolution_rad() / kCellsPerResolution),
      centres_(beam_.Prepare(Pick(srp_->grid(), cells_.centres()))),
      members_(beam_.Prepare(Pick(srp_->grid(), cells_.members()))) {
  const geometry::DirectionGrid& grid = srp_->grid();
  const double near = std::cos(kMaximumRadius_rad);
  for (int i = 0; i < grid.size(); ++i) {
    first_neighbour_.push_back(static_cast<int>(neighbours_.size()));
    cells_.VisitAround(grid[i], kMaximumRadius_rad, [&](int j) {
      if (j != i && grid[i].dot(grid[j]) >= near) neighbours_.push_back(j);
    });
  }
  first_neighbour_.push_back(static_cast<int>(neighbours_.size()));
}

double PeakFinder::ResidualAt(const AudioScan& scan, std::span<const Removed> removed,
                              const Eigen::Vector3d& direction) const {
  double power = srp_->PowerAt(scan, direction);
  for (const Removed& wave : removed) {
    power -= wave.gain * (beam_.ResponseAt(wave.source, direction) - beam_.Incoherent());
  }
  return power;
}

// The maximum near `start`: Newton's steps on quadratics through six directions, which come closer.
Eigen::Vector3d PeakFinder::Climb(const AudioScan& scan, std::span<const Removed> removed,
                                  const Eigen::Vector3d& start) const {
  const double spacing_rad = srp_->grid().spacing_rad();
  Eigen::Vector3d direction = start;
  for (const double step : {0.5, 0.25, 0.1, 0.1, 0.1, 0.1}) {
    const double step_rad = step * spacing_rad;
    const Eigen::Vector3d east = direction.unitOrthogonal();
    const Eigen::Vector3d north = direction.cross(east);
    const auto power_at = [&](int e, int n) {
      return ResidualAt(scan, removed,
                        (direction + step_rad * (e * east + n * north)).normalized());
    };
    const double here = power_at(0, 0);
    const double eastward = power_at(1, 0);
    const double northward = power_at(0, 1);
    const Eigen::Vector2d before(power_at(-1, 0), power_at(0, -1));
    const Eigen::Vector2d gradient(0.5 * (eastward - before[0]), 0.5 * (northward - before[1]));
    Eigen::Matrix2d curvature;
    curvature(0, 0) = eastward - 2.0 * here + before[0];
    curvature(1, 1) = northward - 2.0 * here + before[1];
    curvature(0, 1) = curvature(1, 0) = power_at(1, 1) - eastward - northward + here;
    if (gradient.norm() == 0.0) break;
    const bool maximum = curvature(0, 0) < 0.0 && curvature.determinant() > 0.0;
    Eigen::Vector2d steps =
        maximum ? Eigen::Vector2d(-curvature.inverse() * gradient) : gradient.normalized();
    constexpr double kMaxSteps = 1.5;
    if (steps.norm() > kMaxSteps) steps *= kMaxSteps / steps.norm();
    direction = (direction + step_rad * (steps[0] * east + steps[1] * north)).normalized();
    constexpr double kDone = 0.005;  // of the spacing
    if (step <= 0.1 && step * steps.norm() < kDone) break;
  }
  return direction;
}

PeakFinder::Maximum PeakFinder::Largest(const AudioScan& scan, std::span<const Removed> removed,
                                        std::span<const float> residual, double floor,
                                        double least_height) const {
  const auto at_centre = std::max_element(residual.begin(), residual.end());
  Maximum largest{*at_centre, cells_.centres()[at_centre - residual.begin()]};
  const auto worth_a_look =
      static_cast<float>(floor + kLeastAtCentre * std::max(*at_centre - floor, least_height));
  for (int cell = 0; cell < cells_.size(); ++cell) {
    if (residual[cell] < worth_a_look) continue;
    const Maximum of_cell = LargestOf(scan, removed, cell);
    if (of_cell.power > largest.power) largest = of_cell;
  }
  return largest;
}

PeakFinder::Maximum PeakFinder::LargestOf(const AudioScan& scan, std::span<const Removed> removed,
                                          int cell) const {
  const int begin = cells_.begin(cell);
  const int count = cells_.begin(cell + 1) - begin;
  const std::span<const int> members = cells_.members().subspan(begin, count);
  std::vector<float> power(count);
  for (int m = 0; m < count; ++m) power[m] = scan.power[members[m]];
  for (const Removed& wave : removed) {
    beam_.AddResponse(wave.source, static_cast<float>(-wave.gain),
                      static_cast<float>(beam_.Incoherent()), members_, begin, power);
  }
  const auto largest = std::max_element(power.begin(), power.end());
  return {*largest, members[largest - power.begin()]};
}

Eigen::Vector3d PeakFinder::Reported(const Eigen::Vector3d& direction) const {
  if (beam_.array_rank() != 2) return direction;
  const Eigen::Vector3d image = beam_.Distinguishable(direction);
  return Covers(image) ? image : direction;
}

void PeakFinder::ReadCentres(const AudioScan& scan, std::vector<float>& residual) const {
  residual.resize(cells_.size());
  for (int cell = 0; cell < cells_.size(); ++cell) {
    residual[cell] = scan.power[cells_.centres()[cell]];
  }
}

void PeakFinder::AddFaint(const AudioScan& scan, std::span<const Eigen::Vector3d> strong,
                          std::span<const float> residual, const Background& background,
                          Peaks& found) const {
  const auto least = static_cast<float>(
      background.floor + std::max(evidence_.faint_spreads * background.spread,
                                  evidence_.faint_incoherent_spreads * beam_.IncoherentSpread()));
  std::vector<int> cells;
  for (int cell = 0; cell < cells_.size(); ++cell) {
    if (residual[cell] > least) cells.push_back(cell);
  }
  std::stable_sort(cells.begin(), cells.end(),
                   [&](int a, int b) { return residual[a] > residual[b]; });
  // What is left near a peak belongs to it.
  const double near = std::cos(evidence_.undecided_radius_rad);
  const geometry::DirectionGrid& grid = srp_->grid();
  std::vector<Eigen::Vector3d> taken;
  for (const Eigen::Vector3d& source : strong) taken.push_back(beam_.Distinguishable(source));
  for (const int cell : cells) {
    if (static_cast<int>(taken.size()) >= evidence_.max_peaks) return;
    const Eigen::Vector3d centre = beam_.Distinguishable(grid[cells_.centres()[cell]]);
    if (std::any_of(taken.begin(), taken.end(),
                    [&](const Eigen::Vector3d& peak) { return peak.dot(centre) > near; })) {
      continue;
    }
    taken.push_back(centre);
    const Maximum largest = LargestOf(scan, /*removed=*/{}, cell);
    found.peaks.push_back({Reported(grid[largest.direction]), largest.power});
  }
}

PeakFinder::Background PeakFinder::BackgroundOf(std::span<const float> residual) const {
  // Values are counted by classes of equal width, and only those of one class are put in order.
  constexpr int kClasses = 1024;
  const auto [least, most] = std::minmax_element(residual.begin(), residual.end());
  const float low = *least;
  const float per_value = *most > low ? (kClasses - 1) / (*most - low) : 0.0f;
  const auto class_of = [&](float value) { return static_cast<int>((value - low) * per_value); };
  std::array<int, kClasses> count = {};
  for (const float value : residual) ++count[class_of(value)];
  std::vector<float> of_class;
  const auto at_rank = [&](std::size_t rank) -> double {
    int c = 0;
    for (; rank >= static_cast<std::size_t>(count[c]); ++c) rank -= count[c];
    of_class.clear();
    std::copy_if(residual.begin(), residual.end(), std::back_inserter(of_class),
                 [&](float value) { return class_of(value) == c; });
    const auto at = of_class.begin() + static_cast<std::ptrdiff_t>(rank);
    std::nth_element(of_class.begin(), at, of_class.end());
    return *at;
  };
  const double median = at_rank((residual.size() - 1) / 2);
  return {median, (median - at_rank((residual.size() - 1) / 4)) / kQuartileInSigmas};
}

std::vector<int> PeakFinder::MaximaOf(const AudioScan& scan, const Background& background) const {
  const auto least = static_cast<float>(background.floor + kMaximumSpreads * background.spread);
  std::vector<int> maxima;
  for (int i = 0; i < srp_->grid().size(); ++i) {
    const float power = scan.power[i];
    if (power > least && std::none_of(neighbours_.begin() + first_neighbour_[i],
                                      neighbours_.begin() + first_neighbour_[i + 1],
                                      [&](int j) { return scan.power[j] > power; })) {
      maxima.push_back(i);
    }
  }
  return maxima;
}

bool PeakFinder::Covers(const Eigen::Vector3d& direction) const {
  const geometry::DirectionGrid& grid = srp_->grid();
  const double near = std::cos(grid.spacing_rad());
  bool covers = false;
  cells_.VisitAround(direction, grid.spacing_rad(),
                     [&](int i) { covers |= grid[i].dot(direction) > near; });
  return covers;
}

Peaks PeakFinder::Find(const AudioScan& scan, AudioScan& memory) const {
  const double incoherent = beam_.Incoherent();
  const double least_height = evidence_.threshold_incoherent_spreads * beam_.IncoherentSpread();
  const geometry::DirectionGrid& grid = srp_->grid();
  Peaks found;
  std::vector<float> residual;
  ReadCentres(scan, residual);
  Background background = BackgroundOf(residual);
  found.maxima = MaximaOf(scan, background);
  std::vector<Removed> removed;
  while (static_cast<int>(removed.size()) < evidence_.max_peaks) {
    const Maximum largest = Largest(scan, removed, residual, background.floor, least_height);
    if (!(largest.power > background.floor + least_height)) break;
    const Eigen::Vector3d& start = grid[largest.direction];
    Eigen::Vector3d direction = Climb(scan, removed, start);
    const double power = std::max<double>(largest.power, ResidualAt(scan, removed, direction));
    // What is not a plane wave has the power of incoherent noise or more. The median can lie below,
    // among the side lobes of the peak.
    const double gain =
        (power - std::max(background.floor, incoherent)) / (srp_->band_bins() - incoherent);
    beam_.AddResponse(direction, static_cast<float>(-gain), static_cast<float>(incoherent),
                      centres_, 0, residual);
    // The peak must stand out of what is left without it: its own side lobes are no noise.
    const Background left = BackgroundOf(residual);
    if (!(power > left.floor + std::max(evidence_.threshold_spreads * left.spread, least_height))) {
      break;
    }
    background = left;
    removed.push_back({direction, gain});
    const bool moved_off = start.dot(direction) < std::cos(grid.spacing_rad());
    if (moved_off && !Covers(direction)) continue;
    found.peaks.push_back({Reported(direction), power});
  }
  std::stable_sort(removed.begin(), removed.end(),
                   [](const Removed& a, const Removed& b) { return a.gain > b.gain; });
  std::vector<Eigen::Vector3d> strong;
  for (const Removed& wave : removed) strong.push_back(wave.source);
  const AudioScan* rest = &scan;
  if (!strong.empty()) {
    srp_->Without(scan, strong, memory);
    rest = &memory;
    ReadCentres(*rest, residual);
    background = BackgroundOf(residual);
    const std::vector<int> of_scan = std::move(found.maxima), of_rest = MaximaOf(*rest, background);
    found.maxima.clear();
    std::set_union(of_scan.begin(), of_scan.end(), of_rest.begin(), of_rest.end(),
                   std::back_inserter(found.maxima));
  }
  AddFaint(*rest, strong, residual, background, found);
  found.noise_floor = background.floor;
  found.spread = background.spread;
  std::stable_sort(found.peaks.begin(), found.peaks.end(),
                   [](const Peak& a, const Peak& b) { return a.power > b.power; });
  return found;
}

// Angle within which all directions on one side of the plane lie whose parts along it are no
// further from that of `direction`.
double PeakFinder::Reach_rad(const Eigen::Vector3d& direction, double along_plane) const {
  const double along = beam_.AlongPlane(direction).norm();
  const auto height = [](double at) { return std::sqrt(std::max(0.0, 1.0 - at * at)); };
  const double rise = std::max(height(std::max(0.0, along - along_plane)) - height(along),
                               height(along) - height(std::min(1.0, along + along_plane)));
  return 2.0 * std::asin(std::min(1.0, 0.5 * std::hypot(along_plane, rise)));
}

std::vector<float> PeakFinder::Likelihood(std::span<const Peak> peaks) const {
  const geometry::DirectionGrid& grid = srp_->grid();
  const bool in_plane = beam_.array_rank() == 2;
  std::vector<float> likelihood(grid.size(), static_cast<float>(evidence_.p_rest));
  // Of an array in a plane, the parts along it may be `along_plane` apart instead.
  const auto tell = [&](double radius_rad, double along_plane, double value, bool reflections) {
    const double near = std::cos(radius_rad);
    for (const Peak& peak : peaks) {
      if (peak.reflection && !reflections) continue;
      const Eigen::Vector3d image = beam_.Distinguishable(peak.direction_in_array);
      const auto tell_one = [&](int i) {
        if (image.dot(beam_.Distinguishable(grid[i])) >= near ||
            (in_plane && beam_.AlongPlane(grid[i] - image).norm() < along_plane)) {
          likelihood[i] = static_cast<float>(value);
        }
      };
      if (beam_.array_rank() == 1) {
        for (int i = 0; i < grid.size(); ++i) tell_one(i);
        continue;
      }
      const double reach_rad = std::max(radius_rad, in_plane ? Reach_rad(image, along_plane) : 0.0);
      cells_.VisitAround(image, reach_rad, tell_one);
      if (in_plane) cells_.VisitAround(beam_.MirrorImage(image), reach_rad, tell_one);
    }
  };
  tell(evidence_.undecided_radius_rad, 0.0, evidence_.p_undecided, /*reflections=*/true);
  tell(evidence_.peak_radius_rad, std::sqrt(0.5) * std::sin(evidence_.peak_radius_rad),
       evidence_.p_peak, /*reflections=*/false);
  return likelihood;
}

}  // namespace soundmap::acoustics
