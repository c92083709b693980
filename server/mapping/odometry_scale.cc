#include "mapping/odometry_scale.h"

#include <cmath>

#include "geometry/angles.h"

namespace soundmap::mapping {
namespace {

// A step is long enough when the odometry's own noise is small beside it.
constexpr double kStep_m = 0.5;
constexpr double kStep_rad = geometry::RadFromDeg(20.0);
// Of the drive, in all; else a single slip would make the scale.
constexpr double kMinDriven_m = 10.0;
constexpr double kMinTurned_rad = 2.0 * geometry::kPi;
constexpr double kMaxError = 0.1;

// One axis of the regression of the mapped steps on the odometry's.
struct Regression {
  double products = 0.0;
  double squares = 0.0;
  double length = 0.0;

  void Add(double odometry, double mapped) {
    products += odometry * mapped;
    squares += odometry * odometry;
    length += std::abs(odometry);
  }
  double Scale(double min_length) const {
    if (length < min_length) return 1.0;
    const double scale = products / squares;
    return std::abs(scale - 1.0) <= kMaxError ? scale : 1.0;
  }
};

}  // namespace

OdometryScale ScaleOf(std::span<const MappedOdometry> drive) {
  if (drive.empty()) return {};
  Regression translation, rotation;
  MappedOdometry moved_from = drive.front(), turned_from = drive.front();
  double turned_rad = 0.0;  // since `turned_from`; may be more than half a turn
  geometry::Pose2 last = drive.front().odom_from_base;
  for (const MappedOdometry& here : drive) {
    turned_rad += geometry::NormalizeAngle(here.odom_from_base.yaw_rad - last.yaw_rad);
    last = here.odom_from_base;
    const geometry::Pose2 by_odometry = moved_from.odom_from_base.Inverse() * here.odom_from_base;
    const double moved_m = std::hypot(by_odometry.x_m, by_odometry.y_m);
    if (moved_m >= kStep_m) {
      const geometry::Pose2 mapped = moved_from.map_from_base.Inverse() * here.map_from_base;
      translation.Add(moved_m, std::hypot(mapped.x_m, mapped.y_m));
      moved_from = here;
    }
    if (std::abs(turned_rad) >= kStep_rad) {
      const double mapped_rad = here.map_from_base.yaw_rad - turned_from.map_from_base.yaw_rad;
      rotation.Add(turned_rad, turned_rad + geometry::NormalizeAngle(mapped_rad - turned_rad));
      turned_from = here;
      turned_rad = 0.0;
    }
  }
  return {translation.Scale(kMinDriven_m), rotation.Scale(kMinTurned_rad)};
}

}  // namespace soundmap::mapping
