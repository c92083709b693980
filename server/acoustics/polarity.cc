#include "acoustics/polarity.h"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <utility>

#include "acoustics/float4.h"
#include "acoustics/flush_denormals.h"
#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

constexpr int kMaxMicrophones = 64;
constexpr double kMin_hz = 100.0;  // below, wind and the microphones' own noise
// The window spreads a constant offset over the bins 0 and 1.
constexpr int kFirstCleanBin = 2;
constexpr double kMaxPhase_rad = geometry::kPi / 2.0;  // k d
constexpr double kMemory_s = 30.0;

// Bins beside the band whose lines matter.
constexpr int kBeside = 8;
constexpr int kReach = Polarity::kMaxBins + kBeside;
// How strong a bin must be to say more than a line that lies some bins away, at kReach + their
// number: three times that line's skirt, of its power. The Hann window's transform is
// sin(pi x) / (pi x (1 - x^2)), and 0.85 half a bin from the line, where its strongest bin may lie.
constexpr auto kAboveSkirt = [] {
  std::array<float, 2 * kReach + 1> power{};
  for (int distance = 2; distance <= kReach; ++distance) {
    const double x = distance - 0.5;
    const double skirt = 1.0 / (geometry::kPi * x * (x * x - 1.0)) / 0.85;
    power[kReach + distance] = power[kReach - distance] = static_cast<float>(3.0 * skirt * skirt);
  }
  return power;
}();

// A line fills this many bins. It may stand still with a node through the array, where the
// microphones on one side have the opposite phase: what is certain goes beyond what these bins can
// say, by this mean cosine of the other bins. Rooms give it twice that; independent noise leaves
// 1 / sqrt(2 n) for n of them.
constexpr int kLineBins = 3;
constexpr float kCertain = 0.25f;
constexpr float kMinObservations = 100.0f;

// The least distance that connects all microphones, from neighbour to neighbour.
double WidestGap(const std::vector<Eigen::Vector3d>& mic_in_array_m) {
  const std::size_t count = mic_in_array_m.size();
  std::vector<double> nearest_m(count,
                                std::numeric_limits<double>::infinity());  // of those reached
  std::vector<bool> reached(count);
  double widest_m = 0.0;
  for (std::size_t n = 0, next = 0; n < count; ++n, next = 0) {
    if (n == 0) nearest_m[0] = 0.0;
    while (reached[next]) ++next;
    for (std::size_t m = next + 1; m < count; ++m) {
      if (!reached[m] && nearest_m[m] < nearest_m[next]) next = m;
    }
    reached[next] = true;
    widest_m = std::max(widest_m, nearest_m[next]);
    for (std::size_t m = 0; m < count; ++m) {
      nearest_m[m] = std::min(nearest_m[m], (mic_in_array_m[m] - mic_in_array_m[next]).norm());
    }
  }
  return widest_m;
}

}  // namespace

Polarity::Polarity(const FrameLayout& layout, double speed_of_sound_mps,
                   const std::vector<Eigen::Vector3d>& mic_in_array_m)
    : microphones_(static_cast<int>(mic_in_array_m.size())),
      window_samples_(layout.window_samples) {
  const double bin_hz = static_cast<double>(layout.sample_rate_hz) / layout.window_samples;
  const double scan_s = static_cast<double>(layout.scan_period_samples()) / layout.sample_rate_hz;
  keep_ = static_cast<float>(std::exp(-scan_s / kMemory_s));
  first_bin_ = std::max(kFirstCleanBin + 1, static_cast<int>(std::ceil(kMin_hz / bin_hz)));
  const double bin_rad_per_m = 2.0 * geometry::kPi * bin_hz / speed_of_sound_mps;
  const double full_band_m = kMaxPhase_rad / (bin_rad_per_m * (first_bin_ + kMaxBins - 1));
  const double neighbour_m = std::max(full_band_m, 1.05 * WidestGap(mic_in_array_m));
  const int last_bin = static_cast<int>(
      std::min(kMaxPhase_rad / (bin_rad_per_m * neighbour_m) + 1e-9, window_samples_ / 2 - 1.0));
  bins_ = std::clamp(last_bin - first_bin_ + 1, 0, kMaxBins);
  if (microphones_ < 3 || microphones_ > kMaxMicrophones || bins_ <= kLineBins) return;
  for (int a = 0; a < microphones_; ++a) {
    for (int b = a + 1; b < microphones_; ++b) {
      if ((mic_in_array_m[a] - mic_in_array_m[b]).norm() <= neighbour_m) pairs_.push_back({a, b});
    }
  }
  state_.agreement.resize(pairs_.size());
}

bool Polarity::Audible(const FrameSpectra& frame, int rows,
                       std::array<float, kMaxBins>& audible) const {
  const int lowest = std::max(kFirstCleanBin, first_bin_ - kBeside);
  const int highest = std::min(first_bin_ + bins_ + kBeside, window_samples_ / 2) - 1;
  std::array<float, kMaxBins> own{};
  std::array<float, kMaxBins> needed{};
  for (int bin = lowest; bin <= highest; ++bin) {
    // |X_a|^2 + |X_b|^2 of the two microphones of a row is half the sum of these squares.
    float power = 0.0f;
    for (int p = 0; p < rows; ++p) {
      const float* plus = frame.row(p) + 2 * bin;
      const float* minus = frame.row(p) + 2 * (window_samples_ - bin);
      power += plus[0] * plus[0] + plus[1] * plus[1] + minus[0] * minus[0] + minus[1] * minus[1];
    }
    const int at = bin - first_bin_;
    if (at >= 0 && at < bins_) own[at] = power;
    const float* above_skirt = &kAboveSkirt[kReach - at];
    for (int i = 0; i < kMaxBins; ++i) needed[i] = std::max(needed[i], above_skirt[i] * power);
  }
  bool any = false;
  for (int i = 0; i < bins_; ++i) {
    audible[i] = own[i] > needed[i] ? 1.0f : 0.0f;
    any = any || own[i] > needed[i];
  }
  return any;
}

void Polarity::Add(const FrameSpectra& frame, std::span<const int> without) {
  if (pairs_.empty()) return;
  const FlushDenormals flush;
  const int rows = (microphones_ - static_cast<int>(without.size()) + 1) / 2;
  std::array<float, kMaxBins> audible{};
  if (!Audible(frame, rows, audible)) return;

  // Unit phasors, of the signs as they come from the microphones; 0 for those done without.
  struct Phasors {
    alignas(16) float real[kMaxBins];
    alignas(16) float imaginary[kMaxBins];
  };
  std::array<Phasors, kMaxMicrophones> phasors;
  int next = 0;  // microphone of the frame
  for (int n = 0; n < microphones_; ++n) {
    Phasors& own = phasors[n];
    if (std::binary_search(without.begin(), without.end(), n)) {
      own = {};
      continue;
    }
    const float* row = frame.row(next / 2);
    const bool second = next++ % 2 != 0;
    for (int i = 0; i < bins_; ++i) {  // twice the spectra
      const float* plus = row + 2 * (first_bin_ + i);
      const float* minus = row + 2 * (window_samples_ - first_bin_ - i);
      own.real[i] = second ? plus[1] + minus[1] : plus[0] + minus[0];
      own.imaginary[i] = second ? minus[0] - plus[0] : plus[1] - minus[1];
    }
    std::fill(own.real + bins_, own.real + kMaxBins, 0.0f);
    std::fill(own.imaginary + bins_, own.imaginary + kMaxBins, 0.0f);
    const bool turned = std::binary_search(state_.inverted.begin(), state_.inverted.end(), n);
    const float sign = turned ? -1.0f : 1.0f;
    for (int i = 0; i < kMaxBins; ++i) {
      const float squared = own.real[i] * own.real[i] + own.imaginary[i] * own.imaginary[i];
      const float scale = sign * audible[i] / std::sqrt(squared + FLT_MIN);
      own.real[i] *= scale;
      own.imaginary[i] *= scale;
    }
  }

  for (int i = 0; i < bins_; ++i) {
    state_.bin_weight[i] = keep_ * state_.bin_weight[i] + audible[i];
  }
  for (std::size_t p = 0; p < pairs_.size(); ++p) {
    const Phasors& a = phasors[pairs_[p].a];
    const Phasors& b = phasors[pairs_[p].b];
    Float4 sum = {};
    for (int i = 0; i < kMaxBins; i += 4) {
      sum += LoadFloat4(a.real + i) * LoadFloat4(b.real + i) +
             LoadFloat4(a.imaginary + i) * LoadFloat4(b.imaginary + i);
    }
    state_.agreement[p] = keep_ * state_.agreement[p] + ((sum[0] + sum[1]) + (sum[2] + sum[3]));
  }
  Decide(without);
}

void Polarity::Decide(std::span<const int> without) {
  std::array<float, kMaxMicrophones> was;
  std::fill_n(was.begin(), microphones_, 1.0f);
  for (const int n : state_.inverted) was[n] = -1.0f;
  bool at_odds = false;
  std::array<float, kMaxMicrophones> heard{};
  for (std::size_t p = 0; p < pairs_.size(); ++p) {
    const auto [a, b] = pairs_[p];
    at_odds = at_odds || was[a] * was[b] * state_.agreement[p] < 0.0f;
    heard[a] += std::abs(state_.agreement[p]);
    heard[b] += std::abs(state_.agreement[p]);
  }
  if (!at_odds) return;

  std::array<float, kMaxBins> weight = state_.bin_weight;
  std::sort(weight.begin(), weight.end(), std::greater<>());
  const float line = std::accumulate(weight.begin(), weight.begin() + kLineBins, 0.0f);
  const float rest = std::accumulate(weight.begin() + kLineBins, weight.end(), 0.0f);
  if (rest < kMinObservations) return;
  const float certain = line + kCertain * rest;

  // From the microphone that is heard best, always the one next whose sign is the most certain from
  // its neighbours with a sign.
  std::array<float, kMaxMicrophones> sign{};  // 0: not known
  std::array<float, kMaxMicrophones> agreement{};
  std::array<float, kMaxMicrophones> neighbours{};
  auto next = std::max_element(heard.begin(), heard.begin() + microphones_) - heard.begin();
  for (float next_sign = 1.0f; next_sign != 0.0f;) {
    sign[next] = next_sign;
    for (std::size_t p = 0; p < pairs_.size(); ++p) {
      const auto [a, b] = pairs_[p];
      if (a != next && b != next) continue;
      const int other = a == next ? b : a;
      agreement[other] += next_sign * state_.agreement[p];
      ++neighbours[other];
    }
    float most = certain;
    next_sign = 0.0f;
    for (int n = 0; n < microphones_; ++n) {
      if (sign[n] != 0.0f || std::abs(agreement[n]) < most * neighbours[n]) continue;
      if (neighbours[n] == 0.0f) continue;
      most = std::abs(agreement[n]) / neighbours[n];
      next = n;
      next_sign = agreement[n] < 0.0f ? -1.0f : 1.0f;
    }
  }

  // The larger group has the right sign, whatever those may have that are not known but live.
  const auto count = [&](float of) { return std::count(&sign[0], &sign[0] + microphones_, of); };
  const float right = count(1.0f) > count(-1.0f) ? 1.0f : -1.0f;
  const auto dead =
      std::count_if(without.begin(), without.end(), [&](int n) { return sign[n] == 0.0f; });
  if (2 * count(right) <= microphones_ - dead) return;
  std::vector<int> inverted;
  for (int n = 0; n < microphones_; ++n) {
    if (sign[n] == -right || (sign[n] == 0.0f && was[n] < 0.0f)) inverted.push_back(n);
  }
  if (2 * static_cast<int>(inverted.size()) < microphones_) state_.inverted = std::move(inverted);
}

bool Polarity::Restore(State state) {
  const float most = static_cast<float>(kMaxBins) / (1.0f - keep_);
  const auto possible = [&](float value) { return std::abs(value) <= 1.01f * most; };  // no NaN
  const auto ascending = [](const std::vector<int>& list) {
    return std::adjacent_find(list.begin(), list.end(), std::greater_equal<>()) == list.end();
  };
  const bool fits = state.agreement.size() == pairs_.size() &&
                    std::all_of(state.agreement.begin(), state.agreement.end(), possible) &&
                    std::all_of(state.bin_weight.begin(), state.bin_weight.end(), possible) &&
                    ascending(state.inverted) &&
                    2 * static_cast<int>(state.inverted.size()) < microphones_ &&
                    (state.inverted.empty() ||
                     (state.inverted.front() >= 0 && state.inverted.back() < microphones_));
  if (fits) state_ = std::move(state);
  return fits;
}

}  // namespace soundmap::acoustics
