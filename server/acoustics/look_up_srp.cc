#include "acoustics/look_up_srp.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "acoustics/float4.h"
#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

using geometry::kPi;

constexpr int kTaps = 8;  // correlation samples that determine one cubic
constexpr int kTapsBefore = kTaps / 2 - 1;
constexpr int kTileDirections = 512;
constexpr double kFinePerLag = 65536.0;
constexpr int kMaxIntervals = 32000;  // positions fit in 31 bits
// Worst interpolation error of a unit phasor; S is off by at most B times this.
constexpr double kMaxPhasorError = 4e-6;

// Steps of the correlation to choose from, in radians of the band's upper end: the first that is
// exact enough.
constexpr std::array kLagRadians = {0.6, 0.5, 0.4, 0.35, 0.3, 0.27, 0.24, 0.21, 0.18, 0.15};

typedef std::int32_t Int4 __attribute__((vector_size(16)));

Float4 Load(const float* p) {
  Float4 value;
  std::memcpy(&value, __builtin_assume_aligned(p, 16), sizeof(value));
  return value;
}
void Store(float* p, Float4 value) { std::memcpy(p, &value, sizeof(value)); }

// The cubic in t = 0 .. 1 between taps kTapsBefore and kTapsBefore + 1 that follows every e^{j
// omega t} of the band best: least squares over t gives the cubic of each omega, least squares over
// omega the taps of each coefficient. Row m belongs to t^m.
Eigen::MatrixXd CubicFromTaps(const std::vector<double>& radians_per_lag) {
  constexpr int kNodes = 16;
  Eigen::MatrixXd powers(kNodes, 4);
  Eigen::VectorXd node(kNodes);
  for (int i = 0; i < kNodes; ++i) {
    node[i] = 0.5 - 0.5 * std::cos(kPi * (i + 0.5) / kNodes);
    for (int m = 0; m < 4; ++m) powers(i, m) = std::pow(node[i], m);
  }
  const Eigen::MatrixXd fit = powers.completeOrthogonalDecomposition().pseudoInverse();
  const int frequencies = static_cast<int>(radians_per_lag.size());
  // The regularization keeps the taps small where the band is narrow and many combinations serve.
  constexpr double kRegularization = 1e-8;
  Eigen::MatrixXd taps = Eigen::MatrixXd::Zero(2 * frequencies + kTaps, kTaps);
  Eigen::MatrixXd wanted = Eigen::MatrixXd::Zero(2 * frequencies + kTaps, 4);
  for (int f = 0; f < frequencies; ++f) {
    const double omega = radians_per_lag[f];
    for (int k = 0; k < kTaps; ++k) {
      taps(2 * f, k) = std::cos(omega * (k - kTapsBefore));
      taps(2 * f + 1, k) = std::sin(omega * (k - kTapsBefore));
    }
    wanted.row(2 * f) = (fit * (omega * node).array().cos().matrix()).transpose();
    wanted.row(2 * f + 1) = (fit * (omega * node).array().sin().matrix()).transpose();
  }
  for (int k = 0; k < kTaps; ++k) taps(2 * frequencies + k, k) = kRegularization;
  return taps.householderQr().solve(wanted).transpose();
}

double MaxPhasorError(const Eigen::MatrixXd& cubic, const std::vector<double>& radians_per_lag) {
  double worst = 0.0;
  for (const double omega : radians_per_lag) {
    for (int i = 0; i <= 32; ++i) {
      const double t = i / 32.0;
      std::complex<double> value = 0.0;
      for (int k = 0; k < kTaps; ++k) {
        const double weight = cubic(0, k) + t * (cubic(1, k) + t * (cubic(2, k) + t * cubic(3, k)));
        value += weight * std::polar(1.0, omega * (k - kTapsBefore));
      }
      worst = std::max(worst, std::abs(value - std::polar(1.0, omega * t)));
    }
  }
  return worst;
}

}  // namespace

absl::StatusOr<std::unique_ptr<const LookUpSrp>> LookUpSrp::Create(
    const FrameLayout& layout, const std::vector<Eigen::Vector3d>& delay_s,
    const geometry::DirectionGrid& grid) {
  const double max_hz = layout.bin_hz(layout.bins - 1);
  const double smallest_lag_s = kLagRadians.back() / (2.0 * kPi * std::max(max_hz, 1.0));
  if (2.0 * (delay_s.front().norm() / smallest_lag_s + 2.0) > kMaxIntervals) {
    return absl::InvalidArgumentError(
        absl::StrCat("the array is too large for the band: sound takes ", delay_s.front().norm(),
                     " s across it, at ", max_hz, " Hz"));
  }
  std::unique_ptr<LookUpSrp> srp(new LookUpSrp(layout, delay_s));
  srp->BuildInterpolator();
  srp->BuildCells(grid);
  return srp;
}

void LookUpSrp::BuildInterpolator() {
  const double max_delay_s = delay_s_.front().norm();
  const double max_hz = std::max(layout_.bin_hz(layout_.bins - 1), 1.0);
  std::vector<double> radians_per_lag(layout_.bins);
  for (const double radians : kLagRadians) {
    lag_step_s_ = radians / (2.0 * kPi * max_hz);
    for (int b = 0; b < layout_.bins; ++b) {
      radians_per_lag[b] = 2.0 * kPi * layout_.bin_hz(b) * lag_step_s_;
    }
    const Eigen::MatrixXd cubic = CubicFromTaps(radians_per_lag);
    cubic_ = cubic.cast<float>();
    if (MaxPhasorError(cubic, radians_per_lag) <= kMaxPhasorError) break;
  }
  const int reach = static_cast<int>(std::ceil(max_delay_s / lag_step_s_)) + 1;
  centre_ = reach;
  intervals_ = 2 * reach;
  max_lag_ = reach + kTaps / 2;
  even_basis_.resize(max_lag_ + 1, layout_.bins);
  odd_basis_.resize(max_lag_ + 1, layout_.bins);
  for (int b = 0; b < layout_.bins; ++b) {
    for (int lag = 0; lag <= max_lag_; ++lag) {
      even_basis_(lag, b) = static_cast<float>(std::cos(lag * radians_per_lag[b]));
      odd_basis_(lag, b) = static_cast<float>(std::sin(lag * radians_per_lag[b]));
    }
  }
}

void LookUpSrp::BuildCells(const geometry::DirectionGrid& grid) {
  constexpr int kCellsPerTile = kTileDirections / 4;
  tiles_ = (grid.size() + kTileDirections - 1) / kTileDirections;
  cells_.resize(static_cast<std::size_t>(tiles_) * delay_s_.size() * kCellsPerTile);
  Cell* cell = cells_.data();
  for (int tile = 0; tile < tiles_; ++tile) {
    for (const Eigen::Vector3d& delay_s : delay_s_) {
      for (int c = 0; c < kCellsPerTile; ++c, ++cell) {
        for (int lane = 0; lane < 4; ++lane) {
          // The last tile repeats the last direction.
          const int i = std::min(tile * kTileDirections + 4 * c + lane, grid.size() - 1);
          const std::int64_t position =
              std::llround((delay_s.dot(grid[i]) / lag_step_s_ + centre_) * kFinePerLag);
          cell->interval_x2[lane] = static_cast<std::uint16_t>(2 * (position >> 16));
          cell->fraction[lane] = static_cast<std::uint16_t>(position & 0xffff);
        }
      }
    }
  }
}

std::vector<float> LookUpSrp::Correlate(const float* cross_real, const float* cross_imaginary,
                                        int width, float scale) const {
  const int group_count = static_cast<int>(delay_s_.size());
  // g(tau) = sum over f of Re(C e^{-j 2 pi f tau}), eq. (5), its even and its odd part.
  const auto in_band = [&](const float* cross) {
    return Eigen::Map<const Eigen::MatrixXf>(cross, width, group_count).topRows(layout_.bins);
  };
  const Eigen::MatrixXf even = even_basis_ * in_band(cross_real);
  const Eigen::MatrixXf odd = odd_basis_ * in_band(cross_imaginary);

  std::vector<float> correlation(static_cast<std::size_t>(group_count) * intervals_ * 4);
  std::vector<float> lags(2 * max_lag_ + 1);
  Float4 tap[kTaps];
  for (int k = 0; k < kTaps; ++k) {
    float unit = scale;  // the tables give t in units of 2^-16
    for (int m = 0; m < 4; ++m, unit /= static_cast<float>(kFinePerLag)) {
      tap[k][m] = cubic_(m, k) * unit;
    }
  }
  for (int g = 0; g < group_count; ++g) {
    for (int lag = 0; lag <= max_lag_; ++lag) {
      lags[max_lag_ - lag] = even(lag, g) - odd(lag, g);
      lags[max_lag_ + lag] = even(lag, g) + odd(lag, g);
    }
    // Interval j begins at lag j - centre_; its first tap lies kTapsBefore earlier.
    const float* first_tap = &lags[max_lag_ - centre_ - kTapsBefore];
    float* cubic = &correlation[static_cast<std::size_t>(g) * intervals_ * 4];
    for (int j = 0; j < intervals_; ++j) {
      Float4 sum = tap[0] * first_tap[j];
      for (int k = 1; k < kTaps; ++k) sum += tap[k] * first_tap[j + k];
      Store(cubic + 4 * j, sum);
    }
  }
  return correlation;
}

void LookUpSrp::Read(std::span<const float> correlation, float constant,
                     std::span<float> value) const {
  alignas(16) float sums[kTileDirections];
  const Cell* cell = cells_.data();
  for (int tile = 0; tile < tiles_; ++tile) {
    std::fill(std::begin(sums), std::end(sums), 0.0f);
    for (std::size_t g = 0; g < delay_s_.size(); ++g) {
      const float* cubic = &correlation[g * intervals_ * 4];
      for (int d = 0; d < kTileDirections; d += 4, ++cell) {
        Float4 c0 = LoadFloat4(cubic + 2 * cell->interval_x2[0]);
        Float4 c1 = LoadFloat4(cubic + 2 * cell->interval_x2[1]);
        Float4 c2 = LoadFloat4(cubic + 2 * cell->interval_x2[2]);
        Float4 c3 = LoadFloat4(cubic + 2 * cell->interval_x2[3]);
        Transpose(c0, c1, c2, c3);
        const Int4 fraction{cell->fraction[0], cell->fraction[1], cell->fraction[2],
                            cell->fraction[3]};
        const Float4 t = __builtin_convertvector(fraction, Float4);
        Store(sums + d, Load(sums + d) + (c0 + t * (c1 + t * (c2 + t * c3))));
      }
    }
    const int first = tile * kTileDirections;
    const int count = std::min(kTileDirections, static_cast<int>(value.size()) - first);
    for (int d = 0; d < count; ++d) value[first + d] = constant + sums[d];
  }
}

double LookUpSrp::SumAt(std::span<const float> correlation,
                        const Eigen::Vector3d& direction) const {
  double sum = 0.0;
  for (std::size_t g = 0; g < delay_s_.size(); ++g) {
    const double position = delay_s_[g].dot(direction) / lag_step_s_ + centre_;
    const double interval = std::floor(position);
    const double t = (position - interval) * kFinePerLag;
    const float* c = &correlation[(g * intervals_ + static_cast<int>(interval)) * 4];
    sum += c[0] + t * (c[1] + t * (c[2] + t * c[3]));
  }
  return sum;
}

}  // namespace soundmap::acoustics
