#include "cli/pose_track.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace soundmap::cli {
namespace {

constexpr std::int64_t kEndToleranceNs = 1'000'000;

bool Earlier(const StampedPose& a, const StampedPose& b) { return a.time_ns < b.time_ns; }

}  // namespace

double WrapAngle(double angle_rad) {
  const double wrapped = std::remainder(angle_rad, 2.0 * std::numbers::pi);
  return wrapped <= -std::numbers::pi ? std::numbers::pi : wrapped;
}

PoseTrack::PoseTrack(std::vector<StampedPose> poses) : poses_(std::move(poses)) {
  std::stable_sort(poses_.begin(), poses_.end(), Earlier);
}

std::optional<Pose2> PoseTrack::At(std::int64_t time_ns, std::int64_t max_gap_ns) const {
  if (poses_.empty()) return std::nullopt;
  const auto after =
      std::lower_bound(poses_.begin(), poses_.end(), StampedPose{.time_ns = time_ns}, Earlier);
  if (after != poses_.end() && after->time_ns == time_ns) return after->map_from_base;
  if (after == poses_.begin()) {
    if (after->time_ns - time_ns > kEndToleranceNs) return std::nullopt;
    return after->map_from_base;
  }
  const auto before = after - 1;
  if (after == poses_.end()) {
    if (time_ns - before->time_ns > kEndToleranceNs) return std::nullopt;
    return before->map_from_base;
  }
  const std::int64_t gap_ns = after->time_ns - before->time_ns;
  if (gap_ns > max_gap_ns) return std::nullopt;
  const double fraction =
      static_cast<double>(time_ns - before->time_ns) / static_cast<double>(gap_ns);
  const Pose2& a = before->map_from_base;
  const Pose2& b = after->map_from_base;
  return Pose2{a.x_m + fraction * (b.x_m - a.x_m), a.y_m + fraction * (b.y_m - a.y_m),
               WrapAngle(a.yaw_rad + fraction * WrapAngle(b.yaw_rad - a.yaw_rad))};
}

}  // namespace soundmap::cli
