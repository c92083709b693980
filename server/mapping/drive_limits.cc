#include "mapping/drive_limits.h"

#include <cmath>

#include "geometry/angles.h"
#include "mapping/laser_lines.h"

namespace soundmap::mapping {
namespace {

// Odometry of two stamps close together may differ by this without being a fault.
constexpr double kJitter_m = 0.05;
constexpr double kJitter_rad = 0.05;

constexpr double kPlace_m = 1.0;

}  // namespace

bool MotionLimits::Allow(const geometry::Pose2& step, frames::TimeNs duration_ns) const {
  const double duration_s = frames::SecondsFromNs(duration_ns);
  return std::hypot(step.x_m, step.y_m) <= max_speed_mps * duration_s + kJitter_m &&
         std::abs(step.yaw_rad) <= max_turn_rate_radps * duration_s + kJitter_rad;
}

bool KeyScanPlaces::Take(const geometry::Pose2& map_from_base) {
  const auto square = SquareOf(
      Eigen::Vector2f(static_cast<float>(map_from_base.x_m), static_cast<float>(map_from_base.y_m)),
      kPlace_m);
  if (!square) return false;
  const int quarter = static_cast<int>(std::floor(map_from_base.yaw_rad / (geometry::kPi / 2.0)));
  int& taken = taken_[KeyOf(Square(4 * square->x() + (quarter & 3), square->y()))];
  if (taken >= scans_per_place_) return false;
  ++taken;
  return true;
}

}  // namespace soundmap::mapping
