#include "acoustics/srp_phat.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>

#include "absl/strings/str_cat.h"
#include "acoustics/flush_denormals.h"
#include "geometry/angles.h"

namespace soundmap::acoustics {

absl::StatusOr<std::shared_ptr<const SrpPhat>> SrpPhat::Create(
    const FrameLayout& layout, double speed_of_sound_mps,
    const std::vector<Eigen::Vector3d>& mic_in_array_m, geometry::DirectionGrid grid) {
  const int microphones = static_cast<int>(mic_in_array_m.size());
  if (microphones < 2 || microphones > 64) {
    return absl::InvalidArgumentError(
        absl::StrCat("the array has ", microphones, " microphone(s); it must have 2 to 64"));
  }
  for (int a = 0; a < microphones; ++a) {
    if (!mic_in_array_m[a].allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat("the position of mic_", a, " is not finite"));
    }
  }
  if (grid.size() == 0) {
    return absl::InvalidArgumentError("the grid of candidate directions is empty");
  }
  std::shared_ptr<SrpPhat> srp(new SrpPhat(layout, std::move(grid), microphones));
  absl::Status status = srp->Build(speed_of_sound_mps, mic_in_array_m);
  if (!status.ok()) return status;
  return std::shared_ptr<const SrpPhat>(std::move(srp));
}

absl::Status SrpPhat::GroupPairs(double speed_of_sound_mps,
                                 const std::vector<Eigen::Vector3d>& mic_in_array_m) {
  constexpr double kSamePlace_m = 1e-6;
  constexpr double kSameDifference_m = 1e-6;
  std::vector<Eigen::Vector3d> difference_m;  // of the groups
  for (int a = 0; a < microphones_; ++a) {
    target_.push_back({-1, 1.0f});
    for (int b = a + 1; b < microphones_; ++b) {
      const Eigen::Vector3d of_pair_m = mic_in_array_m[a] - mic_in_array_m[b];
      if (of_pair_m.norm() < kSamePlace_m) {
        return absl::InvalidArgumentError(
            absl::StrCat("mic_", a, " and mic_", b, " are at the same place"));
      }
      PairTarget target{0, 1.0f};
      for (const Eigen::Vector3d& of_group_m : difference_m) {
        if ((of_group_m - of_pair_m).norm() < kSameDifference_m) break;
        if ((of_group_m + of_pair_m).norm() < kSameDifference_m) {
          target.sign = -1.0f;
          break;
        }
        ++target.group;
      }
      if (target.group == static_cast<int>(difference_m.size())) difference_m.push_back(of_pair_m);
      target_.push_back(target);
    }
  }
  const int groups = static_cast<int>(difference_m.size());
  std::vector<int> order(groups);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return difference_m[a].norm() > difference_m[b].norm(); });
  std::vector<int> place(groups);
  for (const int group : order) {
    place[group] = static_cast<int>(delay_s_.size());
    delay_s_.emplace_back(difference_m[group] / speed_of_sound_mps);
  }
  pairs_of_group_.assign(groups, 0.0f);
  for (PairTarget& target : target_) {
    target.group = target.group < 0 ? groups : place[target.group];
    if (target.group < groups) pairs_of_group_[target.group] += 1.0f;
  }
  return absl::OkStatus();
}

absl::Status SrpPhat::Build(double speed_of_sound_mps,
                            const std::vector<Eigen::Vector3d>& mic_in_array_m) {
  absl::Status grouped = GroupPairs(speed_of_sound_mps, mic_in_array_m);
  if (!grouped.ok()) return grouped;
  harmonic_ = HarmonicSrp::Create(layout_, delay_s_, grid_);
  if (!harmonic_) {
    auto look_up = LookUpSrp::Create(layout_, delay_s_, grid_);
    if (!look_up.ok()) return look_up.status();
    look_up_ = *std::move(look_up);
  }
  return absl::OkStatus();
}

std::size_t SrpPhat::cross_floats() const {
  return (delay_s_.size() + 1) * static_cast<std::size_t>(PaddedToRow(layout_.bins));
}

void SrpPhat::Scan(const PhatSpectra& spectra, AudioScan& scan) const {
  const FlushDenormals flush;
  // Past the last group lies the power of each microphone.
  scan.cross.resize(2 * cross_floats());
  CrossSpectra sum;
  sum.real = spectra.real.data();
  sum.imaginary = spectra.imaginary.data();
  sum.frames = spectra.frames;
  sum.microphones = microphones_;
  sum.width = spectra.width;
  sum.target = target_.data();
  sum.groups = static_cast<int>(delay_s_.size()) + 1;
  sum.group_real = scan.cross.data();
  sum.group_imaginary = scan.cross.data() + cross_floats();
  BestKernels().cross_spectra(sum);

  const float* own_power = sum.group_real + delay_s_.size() * spectra.width;
  scan.auto_power = 0.0f;
  for (int b = 0; b < layout_.bins; ++b) scan.auto_power += 0.5f * pair_scale() * own_power[b];
  Steer(scan);
}

void SrpPhat::Without(const AudioScan& scan, std::span<const Eigen::Vector3d> directions,
                      AudioScan& rest) const {
  const FlushDenormals flush;
  rest.cross = scan.cross;
  rest.auto_power = scan.auto_power;
  for (const Eigen::Vector3d& direction : directions) TakeOff(direction, rest);
  Steer(rest);
}

void SrpPhat::TakeOff(const Eigen::Vector3d& direction, AudioScan& scan) const {
  // The cross-spectra of a unit wave are e^{j w tau}. They are turned along the bins, kRowFloats of
  // them at a time.
  const auto width = static_cast<std::size_t>(PaddedToRow(layout_.bins));
  const std::size_t groups = delay_s_.size();
  const double first_rad_s = 2.0 * geometry::kPi * layout_.bin_hz(0);
  const double bin_rad_s = 2.0 * geometry::kPi * (layout_.bin_hz(1) - layout_.bin_hz(0));
  scan.workspace.resize(2 * groups * width + width);
  float* cosines = scan.workspace.data();
  float* sines = cosines + groups * width;
  float* __restrict gain = sines + groups * width;
  std::fill_n(gain, width, 0.0f);
  float pairs = 0.0f;
  for (std::size_t g = 0; g < groups; ++g) {
    const double tau_s = delay_s_[g].dot(direction);
    float* __restrict c = cosines + g * width;
    float* __restrict s = sines + g * width;
    std::complex<double> wave = std::polar(1.0, first_rad_s * tau_s);
    const std::complex<double> step = std::polar(1.0, bin_rad_s * tau_s);
    std::complex<double> turn = 1.0;  // kRowFloats bins on
    for (int b = 0; b < kRowFloats; ++b, wave *= step, turn *= step) {
      c[b] = static_cast<float>(wave.real());
      s[b] = static_cast<float>(wave.imag());
    }
    const auto turn_real = static_cast<float>(turn.real());
    const auto turn_imaginary = static_cast<float>(turn.imag());
    for (std::size_t b = kRowFloats; b < width; b += kRowFloats) {
      for (std::size_t i = b; i < b + kRowFloats; ++i) {
        c[i] = c[i - kRowFloats] * turn_real - s[i - kRowFloats] * turn_imaginary;
        s[i] = c[i - kRowFloats] * turn_imaginary + s[i - kRowFloats] * turn_real;
      }
    }
    const float* __restrict real = scan.cross.data() + g * width;
    const float* __restrict imaginary = real + cross_floats();
    for (std::size_t b = 0; b < width; ++b) gain[b] += real[b] * c[b] + imaginary[b] * s[b];
    pairs += pairs_of_group_[g];
  }
  for (std::size_t b = 0; b < width; ++b) gain[b] = std::max(0.0f, gain[b] / pairs);
  for (std::size_t g = 0; g < groups; ++g) {
    const float* __restrict c = cosines + g * width;
    const float* __restrict s = sines + g * width;
    float* __restrict real = scan.cross.data() + g * width;
    float* __restrict imaginary = real + cross_floats();
    for (std::size_t b = 0; b < width; ++b) {
      const float power = pairs_of_group_[g] * gain[b];
      real[b] -= power * c[b];
      imaginary[b] -= power * s[b];
    }
  }
}

void SrpPhat::Steer(AudioScan& scan) const {
  const int width = PaddedToRow(layout_.bins);
  const float* real = scan.cross.data();
  const float* imaginary = real + cross_floats();
  scan.power.resize(grid_.size());
  if (harmonic_) {
    scan.workspace.resize(harmonic_->workspace_floats());
    harmonic_->Expand(real, imaginary, width, pair_scale(), scan.auto_power, scan.workspace.data(),
                      scan.harmonics);
    harmonic_->Synthesize(scan.harmonics, scan.workspace.data(), scan.power);
  } else {
    scan.correlation = look_up_->Correlate(real, imaginary, width, pair_scale());
    look_up_->Read(scan.correlation, scan.auto_power, scan.power);
  }
}

double SrpPhat::PowerAt(const AudioScan& scan, const Eigen::Vector3d& direction) const {
  if (harmonic_) return harmonic_->ValueAt(scan.harmonics, direction);
  return scan.auto_power + look_up_->SumAt(scan.correlation, direction);
}

}  // namespace soundmap::acoustics
