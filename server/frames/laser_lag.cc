#include "frames/laser_lag.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::frames {
namespace {

// The lags that are tried.
constexpr double kFirst_s = -0.2;
constexpr double kStep_s = 0.02;

constexpr std::size_t kMaxWaiting = 1000;
// Slower turns tell nothing, faster ones are a fault.
constexpr double kMinTurn_rad = 0.01;
constexpr double kMaxTurn_rad = 1.0;
constexpr double kMinTurned_rad = 1.0;
// The best lag explains the turns this much better than one this far from it.
constexpr int kApart = 5;
constexpr double kMaxErrorToErrorApart = 0.7;
// The standard deviation of a turn as told by two scans and the odometry is at least this one.
constexpr double kMinTurnStd_rad = 0.01;
// A larger error is a fault of the scan's or the odometry's, whatever the lag.
constexpr double kMaxError_rad = 20.0 * kMinTurnStd_rad;

TimeNs LagNs(int i) { return NsFromSeconds(kFirst_s + kStep_s * i); }

}  // namespace

void LaserLag::Add(TimeNs stamp_ns, double yaw_rad) {
  Turn turn{.begin_ns = stamp_ns, .end_ns = stamp_ns, .turn_rad = yaw_rad};
  if (state_.last) {
    const double turn_rad = geometry::NormalizeAngle(yaw_rad - state_.last->turn_rad);
    if (std::abs(turn_rad) >= kMinTurn_rad && std::abs(turn_rad) <= kMaxTurn_rad) {
      state_.waiting.push_back({state_.last->end_ns, stamp_ns, turn_rad});
      if (state_.waiting.size() > kMaxWaiting) state_.waiting.pop_front();
    }
  }
  state_.last = turn;
}

void LaserLag::Follow(const OdometryTrack& track) {
  while (!state_.waiting.empty() && !track.empty() &&
         state_.waiting.front().end_ns - LagNs(0) <= track.newest_ns()) {
    const Turn turn = state_.waiting.front();
    state_.waiting.pop_front();
    std::array<double, kLags> error_rad;
    bool covered = true;
    for (int i = 0; i < kLags && covered; ++i) {
      const auto begin = track.At(turn.begin_ns - LagNs(i));
      const auto end = track.At(turn.end_ns - LagNs(i));
      covered = begin && end;
      if (!covered) break;
      error_rad[i] = geometry::NormalizeAngle(turn.turn_rad - (end->yaw_rad - begin->yaw_rad));
    }
    if (!covered) continue;
    ++state_.turns;
    state_.turned_rad += std::abs(turn.turn_rad);
    for (int i = 0; i < kLags; ++i)
      state_.squared_error[i] +=
          std::min(error_rad[i] * error_rad[i], kMaxError_rad * kMaxError_rad);
  }
}

std::optional<double> LaserLag::lag_s(double max_std_s) const {
  if (state_.turned_rad < kMinTurned_rad) return std::nullopt;
  const auto least = std::min_element(state_.squared_error.begin(), state_.squared_error.end());
  const int i = static_cast<int>(least - state_.squared_error.begin());
  if (i < kApart || i + kApart >= kLags) return std::nullopt;
  for (const int apart : {i - kApart, i + kApart}) {
    if (!(*least <= kMaxErrorToErrorApart * state_.squared_error[apart])) return std::nullopt;
  }
  // The squared error grows by the square of the distance from the best lag times this.
  const double growth_rad2_per_s2 =
      (0.5 * (state_.squared_error[i - kApart] + state_.squared_error[i + kApart]) - *least) /
      (kApart * kStep_s * kApart * kStep_s);
  const double turn_variance =
      std::max(*least / static_cast<double>(state_.turns), kMinTurnStd_rad * kMinTurnStd_rad);
  if (!(turn_variance <= max_std_s * max_std_s * growth_rad2_per_s2)) return std::nullopt;
  // The vertex of the parabola through the least and its neighbours.
  const double before = state_.squared_error[i - 1], after = state_.squared_error[i + 1];
  const double curvature = before - 2.0 * *least + after;
  const double shift = curvature > 0.0 ? 0.5 * (before - after) / curvature : 0.0;
  return kFirst_s + kStep_s * (i + shift);
}

bool LaserLag::Restore(const State& state) {
  const auto is_sum = [](double sum) { return std::isfinite(sum) && sum >= 0.0; };
  if (state.waiting.size() > kMaxWaiting || state.turns < 0 || !is_sum(state.turned_rad) ||
      !std::all_of(state.squared_error.begin(), state.squared_error.end(), is_sum)) {
    return false;
  }
  state_ = state;
  return true;
}

}  // namespace soundmap::frames
