#include "acoustics/beam_pattern.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

using geometry::kPi;

constexpr double kMaxStep = 0.5;

// Samples to coefficients of the cubic B-spline through them, in place. The ends, where samples are
// missing, are not exact; the error falls by 3.7 a sample.
void Prefilter(double* sample, int count, std::ptrdiff_t stride) {
  const double pole = std::sqrt(3.0) - 2.0;
  for (int i = 1; i < count; ++i) sample[i * stride] += pole * sample[(i - 1) * stride];
  sample[(count - 1) * stride] *= -pole / (1.0 - pole);
  for (int i = count - 2; i >= 0; --i) {
    sample[i * stride] = pole * (sample[(i + 1) * stride] - sample[i * stride]);
  }
  for (int i = 0; i < count; ++i) sample[i * stride] *= 6.0;
}

}  // namespace

BeamPattern::BeamPattern(const FrameLayout& layout, double speed_of_sound_mps,
                         const std::vector<Eigen::Vector3d>& mic_in_array_m)
    : layout_(layout), microphones_(static_cast<int>(mic_in_array_m.size())) {
  BuildGroups(speed_of_sound_mps, mic_in_array_m);
  BuildBand();
  BuildAxes();
  BuildTable();
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

double BeamPattern::BandSum(double delay_s) const {
  const double bin_spacing_hz =
      layout_.sample_rate_hz / static_cast<double>(layout_.window_samples);
  const double mid_hz = 0.5 * (layout_.bin_hz(0) + layout_.bin_hz(layout_.bins - 1));
  // The sum of cos(2 pi f tau) over equally spaced f. Near a zero of the denominator all terms
  // agree.
  const double half_phase = kPi * bin_spacing_hz * delay_s;
  const double turn = std::remainder(half_phase, kPi);
  const double dirichlet =
      std::abs(turn) < 1e-9
          ? layout_.bins * (std::cos(half_phase) < 0.0 && layout_.bins % 2 == 0 ? -1.0 : 1.0)
          : std::sin(layout_.bins * half_phase) / std::sin(half_phase);
  return std::cos(2.0 * kPi * mid_hz * delay_s) * dirichlet;
}

void BeamPattern::BuildBand() {
  constexpr double kStep_rad = 0.02;  // at the band's upper end; linear between: 5e-5 B off
  double max_delay_s = 0.0;
  for (const PairGroup& group : groups_) max_delay_s = std::max(max_delay_s, group.delay_s.norm());
  const double max_rad_s = 2.0 * kPi * std::max(layout_.bin_hz(layout_.bins - 1), 1.0);
  double squares_hz2 = 0.0;
  for (int b = 0; b < layout_.bins; ++b) squares_hz2 += layout_.bin_hz(b) * layout_.bin_hz(b);
  const double rms_rad_s = 2.0 * kPi * std::max(std::sqrt(squares_hz2 / layout_.bins), 1.0);
  resolution_rad_ = kPi / (rms_rad_s * max_delay_s);
  band_step_s_ = kStep_rad / max_rad_s;
  for (PairGroup& group : groups_) group.delay_steps = group.delay_s / band_step_s_;
  // Delays of two directions differ by at most twice the largest delay; the table's corners lie
  // beyond.
  constexpr double kLongest = 8.0;
  band_.resize(static_cast<std::size_t>(std::ceil(kLongest * max_delay_s / band_step_s_)) + 2);
  for (std::size_t i = 0; i < band_.size(); ++i) {
    band_[i] = static_cast<float>(BandSum(static_cast<double>(i) * band_step_s_));
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

  steps_from_direction_.setZero();
  for (int axis = 3 - array_rank_; axis < 3; ++axis) {
    const Eigen::Vector3d along = axes.eigenvectors().col(axis);
    const double step = StepAlong(along);
    steps_from_direction_.row(axis) = along.transpose() / step;
    direction_from_steps_.col(axis) = along * step;
    // Coordinates of differences of two directions, and the splines' taps around them.
    const int reach = static_cast<int>(std::ceil(2.0 / step)) + 2;
    begin_[axis] = axis == 3 - array_rank_ ? -2 : -reach;
    length_[axis] = reach - begin_[axis] + 1;
  }
}

// The longest step that keeps the error of all waves together within this axis's share.
double BeamPattern::StepAlong(const Eigen::Vector3d& axis) const {
  // A wave of k radians a step is off by (k^4 + 0.28 k^6) / 384 or less (up to k = 1.5).
  constexpr double kLongestStep_rad = 1.5;
  double largest_rad = 0.0;
  double fourth_powers = 0.0;
  double sixth_powers = 0.0;
  for (const PairGroup& group : groups_) {
    for (int b = 0; b < layout_.bins; ++b) {
      const double phase_rad = 2.0 * kPi * layout_.bin_hz(b) * std::abs(axis.dot(group.delay_s));
      largest_rad = std::max(largest_rad, phase_rad);
      fourth_powers += 2.0 * group.count * std::pow(phase_rad, 4);
      sixth_powers += 2.0 * group.count * std::pow(phase_rad, 6);
    }
  }
  const double waves = static_cast<double>(layout_.bins) * microphones_ * microphones_;
  const double allowed = 384.0 * kMaxError / array_rank_ * waves;
  double step = std::min(kMaxStep, kLongestStep_rad / largest_rad);
  while (fourth_powers * std::pow(step, 4) + 0.28 * sixth_powers * std::pow(step, 6) > allowed) {
    step *= 0.95;
  }
  return step;
}

void BeamPattern::BuildTable() {
  constexpr int kMargin = 6;  // samples beyond the table for the prefilter
  constexpr double kMaxLookups = 5e8;
  int length[3] = {1, 1, 1};
  int begin[3] = {0, 0, 0};
  int margin[3] = {0, 0, 0};
  double samples = 1.0;
  for (int axis = 3 - array_rank_; axis < 3; ++axis) {
    margin[axis] = kMargin;
    length[axis] = length_[axis] + 2 * kMargin;
    begin[axis] = begin_[axis] - kMargin;
    samples *= length[axis];
  }
  if (!(samples * static_cast<double>(groups_.size()) <= kMaxLookups)) return;

  // Row by row: PairByPair() of its samples, group by group.
  std::vector<double> sample(static_cast<std::size_t>(samples), Incoherent());
  const double per_pair = 2.0 / (static_cast<double>(microphones_) * microphones_);
  double* row = sample.data();
  for (int i = begin[0]; i < begin[0] + length[0]; ++i) {
    for (int j = begin[1]; j < begin[1] + length[1]; ++j, row += length[2]) {
      const Eigen::Vector3d first = direction_from_steps_ * Eigen::Vector3d(i, j, begin[2]);
      for (const PairGroup& group : groups_) {
        const double start = group.delay_steps.dot(first);
        const double step = group.delay_steps.dot(direction_from_steps_.col(2));
        const double weight = per_pair * group.count;
        for (int k = 0; k < length[2]; ++k) row[k] += weight * BandAt(start + k * step);
      }
    }
  }
  const std::ptrdiff_t stride[3] = {static_cast<std::ptrdiff_t>(length[1]) * length[2], length[2],
                                    1};
  for (int axis = 3 - array_rank_; axis < 3; ++axis) {
    for (std::size_t at = 0; at < sample.size(); ++at) {
      if (static_cast<std::ptrdiff_t>(at) / stride[axis] % length[axis] != 0) continue;
      Prefilter(&sample[at], length[axis], stride[axis]);
    }
  }
  table_.reserve(static_cast<std::size_t>(length_[0]) * length_[1] * length_[2]);
  for (int i = margin[0]; i < margin[0] + length_[0]; ++i) {
    for (int j = margin[1]; j < margin[1] + length_[1]; ++j) {
      const double* row = &sample[i * stride[0] + j * stride[1] + margin[2]];
      for (int k = 0; k < length_[2]; ++k) table_.push_back(static_cast<float>(row[k]));
    }
  }
}

double BeamPattern::BandAt(double delay_steps) const {
  const double position = std::abs(delay_steps);
  const auto index = static_cast<std::size_t>(position);
  if (index + 1 >= band_.size()) return BandSum(delay_steps * band_step_s_);
  const double t = position - static_cast<double>(index);
  return (1.0 - t) * band_[index] + t * band_[index + 1];
}

double BeamPattern::PairByPair(const Eigen::Vector3d& difference) const {
  double sum = 0.0;
  for (const PairGroup& group : groups_) {
    sum += group.count * BandAt(group.delay_steps.dot(difference));
  }
  const double n = microphones_;
  return Incoherent() + 2.0 * sum / (n * n);
}

BeamPattern::Places BeamPattern::Prepare(std::span<const Eigen::Vector3d> directions) const {
  Places places;
  places.size_ = static_cast<int>(directions.size());
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<float>& at = places.at_[axis];
    at.reserve(directions.size() + SplineTable::kPadding);
    for (const Eigen::Vector3d& direction : directions) {
      at.push_back(static_cast<float>(
          table_.empty() ? direction[axis] : steps_from_direction_.row(axis) * direction));
    }
    at.resize(directions.size() + SplineTable::kPadding, at.empty() ? 0.0f : at.back());
  }
  return places;
}

void BeamPattern::AddResponse(const Eigen::Vector3d& source, float gain, float offset,
                              const Places& directions, int first, std::span<float> power,
                              bool plain) const {
  if (table_.empty()) {
    for (std::size_t i = 0; i < power.size(); ++i) {
      const std::size_t at = first + i;
      const Eigen::Vector3d direction(directions.at_[0][at], directions.at_[1][at],
                                      directions.at_[2][at]);
      power[i] += gain * (static_cast<float>(PairByPair(direction - source)) - offset);
    }
    return;
  }
  const Eigen::Vector3f origin = (steps_from_direction_ * source).cast<float>();
  const float* const at[3] = {&directions.at_[0][first], &directions.at_[1][first],
                              &directions.at_[2][first]};
  table().Add(at, origin, gain, offset, power, plain);
}

double BeamPattern::ResponseAt(const Eigen::Vector3d& source,
                               const Eigen::Vector3d& direction) const {
  if (table_.empty()) return PairByPair(direction - source);
  return table().At((steps_from_direction_ * (direction - source)).cast<float>());
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
    return along < 0.0 ? MirrorImage(direction) : direction;
  }
  // A point on a half circle from one end of the axis to the other.
  const double across = std::sqrt(std::max(0.0, 1.0 - along * along));
  return along * array_axis_ + across * array_axis_.unitOrthogonal();
}

}  // namespace soundmap::acoustics
