#include "acoustics/srp_phat.h"

#include <algorithm>
#include <numeric>

#include "absl/strings/str_cat.h"
#include "acoustics/flush_denormals.h"

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

absl::StatusOr<std::vector<Eigen::Vector3d>> SrpPhat::GroupPairs(
    double speed_of_sound_mps, const std::vector<Eigen::Vector3d>& mic_in_array_m) {
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
  groups_ = static_cast<int>(difference_m.size());
  std::vector<int> order(groups_);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return difference_m[a].norm() > difference_m[b].norm(); });
  std::vector<int> place(groups_);
  std::vector<Eigen::Vector3d> delay_s;
  for (const int group : order) {
    place[group] = static_cast<int>(delay_s.size());
    delay_s.emplace_back(difference_m[group] / speed_of_sound_mps);
  }
  for (PairTarget& target : target_) {
    target.group = target.group < 0 ? groups_ : place[target.group];
  }
  return delay_s;
}

absl::Status SrpPhat::Build(double speed_of_sound_mps,
                            const std::vector<Eigen::Vector3d>& mic_in_array_m) {
  const auto delay_s = GroupPairs(speed_of_sound_mps, mic_in_array_m);
  if (!delay_s.ok()) return delay_s.status();
  harmonic_ = HarmonicSrp::Create(layout_, *delay_s, grid_);
  if (!harmonic_) {
    auto look_up = LookUpSrp::Create(layout_, *delay_s, grid_);
    if (!look_up.ok()) return look_up.status();
    look_up_ = *std::move(look_up);
  }
  return absl::OkStatus();
}

void SrpPhat::Scan(const PhatSpectra& spectra, AudioScan& scan) const {
  const FlushDenormals flush;
  // Cross-spectra, eq. (4), and past the last group the power of each microphone.
  const std::size_t cross_floats = static_cast<std::size_t>(groups_ + 1) * spectra.width;
  scan.workspace.resize(2 * cross_floats + (harmonic_ ? harmonic_->workspace_floats() : 0));
  CrossSpectra sum;
  sum.real = spectra.real.data();
  sum.imaginary = spectra.imaginary.data();
  sum.frames = spectra.frames;
  sum.microphones = microphones_;
  sum.width = spectra.width;
  sum.target = target_.data();
  sum.groups = groups_ + 1;
  sum.group_real = scan.workspace.data();
  sum.group_imaginary = scan.workspace.data() + cross_floats;
  BestKernels().cross_spectra(sum);

  // A pair counts twice: as (a, b) and as (b, a).
  const float scale = 2.0f / (static_cast<float>(microphones_) * microphones_ * spectra.frames);
  const float* own_power = sum.group_real + static_cast<std::size_t>(groups_) * spectra.width;
  scan.auto_power = 0.0f;
  for (int b = 0; b < layout_.bins; ++b) scan.auto_power += 0.5f * scale * own_power[b];
  scan.power.resize(grid_.size());
  if (harmonic_) {
    float* workspace = scan.workspace.data() + 2 * cross_floats;
    harmonic_->Expand(sum.group_real, sum.group_imaginary, spectra.width, scale, scan.auto_power,
                      workspace, scan.harmonics);
    harmonic_->Synthesize(scan.harmonics, workspace, scan.power);
  } else {
    scan.correlation =
        look_up_->Correlate(sum.group_real, sum.group_imaginary, spectra.width, scale);
    look_up_->Read(scan.correlation, scan.auto_power, scan.power);
  }
}

double SrpPhat::PowerAt(const AudioScan& scan, const Eigen::Vector3d& direction) const {
  if (harmonic_) return harmonic_->ValueAt(scan.harmonics, direction);
  return scan.auto_power + look_up_->SumAt(scan.correlation, direction);
}

}  // namespace soundmap::acoustics
