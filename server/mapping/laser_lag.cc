#include "mapping/laser_lag.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::mapping {
namespace {

// The lags that are tried.
constexpr double kFirst_s = -0.2;
constexpr double kStep_s = 0.02;

constexpr std::size_t kMaxWaiting = 1000;
// Slower turns tell nothing, faster ones are a fault.
constexpr double kMinTurn_rad = 0.01;
constexpr double kMaxTurn_rad = 1.0;
constexpr double kMinTurned_rad = 6.0;
// The best lag explains the turns this much better than one this far from it.
constexpr int kApart = 5;
constexpr double kMaxErrorToErrorApart = 0.7;

frames::TimeNs LagNs(int i) { return frames::NsFromSeconds(kFirst_s + kStep_s * i); }

}  // namespace

void LaserLag::Add(frames::TimeNs stamp_ns, double yaw_rad, bool follows) {
  Turn turn{.begin_ns = stamp_ns, .end_ns = stamp_ns, .turn_rad = yaw_rad};
  if (follows && last_) {
    const double turn_rad = geometry::NormalizeAngle(yaw_rad - last_->turn_rad);
    if (std::abs(turn_rad) >= kMinTurn_rad && std::abs(turn_rad) <= kMaxTurn_rad) {
      waiting_.push_back({last_->end_ns, stamp_ns, turn_rad});
      if (waiting_.size() > kMaxWaiting) waiting_.pop_front();
    }
  }
  last_ = turn;
}

void LaserLag::Follow(const frames::OdometryTrack& track) {
  while (!waiting_.empty() && !track.empty() &&
         waiting_.front().end_ns - LagNs(0) <= track.newest_ns()) {
    const Turn turn = waiting_.front();
    waiting_.pop_front();
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
    turned_rad_ += std::abs(turn.turn_rad);
    for (int i = 0; i < kLags; ++i) squared_error_[i] += error_rad[i] * error_rad[i];
  }
}

std::optional<double> LaserLag::lag_s() const {
  if (turned_rad_ < kMinTurned_rad) return std::nullopt;
  const auto least = std::min_element(squared_error_.begin(), squared_error_.end());
  const int i = static_cast<int>(least - squared_error_.begin());
  if (i < kApart || i + kApart >= kLags) return std::nullopt;
  for (const int apart : {i - kApart, i + kApart}) {
    if (!(*least <= kMaxErrorToErrorApart * squared_error_[apart])) return std::nullopt;
  }
  // The vertex of the parabola through the least and its neighbours.
  const double before = squared_error_[i - 1], after = squared_error_[i + 1];
  const double curvature = before - 2.0 * *least + after;
  const double shift = curvature > 0.0 ? 0.5 * (before - after) / curvature : 0.0;
  return kFirst_s + kStep_s * (i + shift);
}

}  // namespace soundmap::mapping
