#include "acoustics/beam_pattern.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

using geometry::kPi;

constexpr int kTileDirections = 512;
constexpr int kFineShift = 8;               // a fine position is 2^-8 response samples
constexpr double kResponseStep_rad = 0.01;  // at the band's upper end

}  // namespace

BeamPattern::BeamPattern(const FrameLayout& layout, double speed_of_sound_mps,
                         const std::vector<Eigen::Vector3d>& mic_in_array_m,
                         const geometry::DirectionGrid& grid)
    : layout_(layout), microphones_(static_cast<int>(mic_in_array_m.size())) {
  BuildGroups(speed_of_sound_mps, mic_in_array_m);
  BuildAxes();
  BuildResponse();
  BuildPositions(grid);
}

void BeamPattern::BuildGroups(double speed_of_sound_mps,
                              const std::vector<Eigen::Vector3d>& mic_in_array_m) {
  constexpr double kSameDifference_m = 1e-6;
  const double same_s = kSameDifference_m / speed_of_sound_mps;
  for (int a = 0; a < microphones_; ++a) {
    for (int b = a + 1; b < microphones_; ++b) {
      const Eigen::Vector3d delay_s = (mic_in_array_m[a] - mic_in_array_m[b]) / speed_of_sound_mps;
      const auto same = std::find_if(groups_.begin(), groups_.end(), [&](const PairGroup& group) {
        return (group.delay_s - delay_s).norm() < same_s ||
               (group.delay_s + delay_s).norm() < same_s;
      });
      if (same == groups_.end()) {
        groups_.push_back({delay_s, 1});
      } else {
        ++same->count;
      }
    }
  }
}

void BeamPattern::BuildAxes() {
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const PairGroup& group : groups_) scatter += group.delay_s * group.delay_s.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(scatter);  // smallest first
  constexpr double kFlat = 1e-6;  // relative variance: a thickness of a thousandth of the width
  const Eigen::Vector3d variance = axes.eigenvalues() / axes.eigenvalues()[2];
  array_rank_ = variance[1] < kFlat ? 1 : variance[0] < kFlat ? 2 : 3;
  array_axis_ = axes.eigenvectors().col(array_rank_ == 1 ? 2 : 0);
  // A plane's normal points up, or forwards, or left.
  const double orientation = std::abs(array_axis_.z()) > 1e-3   ? array_axis_.z()
                             : std::abs(array_axis_.x()) > 1e-3 ? array_axis_.x()
                                                                : array_axis_.y();
  if (orientation < 0.0) array_axis_ = -array_axis_;
}

void BeamPattern::BuildResponse() {
  double max_delay_s = 0.0;
  for (const PairGroup& group : groups_) max_delay_s = std::max(max_delay_s, group.delay_s.norm());
  response_step_s_ =
      kResponseStep_rad / (2.0 * kPi * std::max(layout_.bin_hz(layout_.bins - 1), 1.0));
  // Delays of two directions differ by at most twice the largest delay.
  response_centre_ = static_cast<int>(std::ceil(2.0 * max_delay_s / response_step_s_)) + 2;
  response_.resize(2 * response_centre_ + 1);
  const double bin_spacing_hz =
      layout_.sample_rate_hz / static_cast<double>(layout_.window_samples);
  const double mid_hz = 0.5 * (layout_.bin_hz(0) + layout_.bin_hz(layout_.bins - 1));
  for (int i = 0; i <= 2 * response_centre_; ++i) {
    const double delay_s = (i - response_centre_) * response_step_s_;
    // The sum of cos(2 pi f tau) over equally spaced f. Near a zero of the denominator all terms
    // agree.
    const double half_phase = kPi * bin_spacing_hz * delay_s;
    const double turn = std::remainder(half_phase, kPi);
    const double dirichlet =
        std::abs(turn) < 1e-9
            ? layout_.bins * (std::cos(half_phase) < 0.0 && layout_.bins % 2 == 0 ? -1.0 : 1.0)
            : std::sin(layout_.bins * half_phase) / std::sin(half_phase);
    response_[i] = static_cast<float>(std::cos(2.0 * kPi * mid_hz * delay_s) * dirichlet);
  }
}

std::int32_t BeamPattern::FinePosition(const PairGroup& group,
                                       const Eigen::Vector3d& direction) const {
  return static_cast<std::int32_t>(
      std::lround(group.delay_s.dot(direction) / response_step_s_ * (1 << kFineShift)));
}

void BeamPattern::BuildPositions(const geometry::DirectionGrid& grid) {
  constexpr int kSampleDirections = 2000;
  while (2 * sample_stride_ <= kTileDirections / 4 &&
         grid.size() / (2 * sample_stride_) >= kSampleDirections) {
    sample_stride_ *= 2;
  }
  tiles_ = (grid.size() + kTileDirections - 1) / kTileDirections;
  positions_.reserve(static_cast<std::size_t>(tiles_) * groups_.size() * kTileDirections);
  for (int tile = 0; tile < tiles_; ++tile) {
    for (const PairGroup& group : groups_) {
      for (int d = 0; d < kTileDirections; ++d) {
        // The last tile repeats the last direction.
        const int i = std::min(tile * kTileDirections + d, grid.size() - 1);
        positions_.push_back(FinePosition(group, grid[i]));
      }
    }
  }
}

double BeamPattern::ResponseAt(const Eigen::Vector3d& source,
                               const Eigen::Vector3d& direction) const {
  const Eigen::Vector3d difference = direction - source;
  double sum = 0.0;
  for (const PairGroup& group : groups_) {
    const double position = group.delay_s.dot(difference) / response_step_s_ + response_centre_;
    const int index = static_cast<int>(position);
    const double t = position - index;
    sum += group.count * ((1.0 - t) * response_[index] + t * response_[index + 1]);
  }
  const double n = microphones_;
  return layout_.bins / n + 2.0 * sum / (n * n);
}

void BeamPattern::AddResponse(const Eigen::Vector3d& source, float gain, float offset, int stride,
                              std::span<float> power) const {
  const float scale = 2.0f / (static_cast<float>(microphones_) * microphones_);
  const float base = static_cast<float>(layout_.bins) / microphones_ - offset;
  // Half a sample is added so that the shift rounds to the nearest.
  constexpr std::int32_t kHalf = 1 << (kFineShift - 1);
  const float* response = response_.data() + response_centre_;
  float sums[kTileDirections];
  const std::int32_t* position = positions_.data();
  for (int tile = 0; tile < tiles_; ++tile) {
    std::fill(std::begin(sums), std::end(sums), 0.0f);
    for (const PairGroup& group : groups_) {
      const auto count = static_cast<float>(group.count);
      const std::int32_t origin = FinePosition(group, source) - kHalf;
      for (int d = 0; d < kTileDirections; d += 4 * stride) {
        for (int lane = d; lane < d + 4; ++lane) {
          sums[lane] += count * response[(position[lane] - origin) >> kFineShift];
        }
      }
      position += kTileDirections;
    }
    const int first = tile * kTileDirections;
    const int count = std::min(kTileDirections, static_cast<int>(power.size()) - first);
    for (int d = 0; d < count; d += 4 * stride) {
      for (int lane = d; lane < std::min(d + 4, count); ++lane) {
        power[first + lane] += gain * (base + scale * sums[lane]);
      }
    }
  }
}

double BeamPattern::IncoherentSpread() const {
  // |Y|^2 of N independent unit phasors over N has the variance (1 - 1/N) / N^2. Neighbours in the
  // sums of eqs. (4) and (5) are correlated:
  // |.|^2 of periodic Hann windows by (2/3)^2 one bin apart, (1/6)^2 two bins apart, (1/6)^2 half a
  // window apart.
  constexpr double kBins = 1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0);
  constexpr double kFrames = 1.0 + 2.0 / 36.0;
  const double n = microphones_;
  return std::sqrt(kBins * kFrames * layout_.bins / layout_.frames_per_scan * (1.0 - 1.0 / n)) / n;
}

Eigen::Vector3d BeamPattern::Distinguishable(const Eigen::Vector3d& direction) const {
  if (array_rank_ == 3) return direction;
  const double along = array_axis_.dot(direction);
  if (array_rank_ == 2) {
    return along < 0.0 ? Eigen::Vector3d(direction - 2.0 * along * array_axis_) : direction;
  }
  // A point on a half circle from one end of the axis to the other.
  const double across = std::sqrt(std::max(0.0, 1.0 - along * along));
  return along * array_axis_ + across * array_axis_.unitOrthogonal();
}

}  // namespace soundmap::acoustics
