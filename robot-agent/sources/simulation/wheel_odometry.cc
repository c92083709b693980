#include "sources/simulation/wheel_odometry.h"

#include <cmath>

namespace soundmap::simulation {

PlanarPose WheelOdometry::Step(const PlanarPose& map_from_base) {
  const double dx_m = map_from_base.x_m - last_true_.x_m;
  const double dy_m = map_from_base.y_m - last_true_.y_m;
  const double true_turn_rad = map_from_base.yaw_rad - last_true_.yaw_rad;
  const double way_m = std::hypot(dx_m, dy_m);
  const double cos_true = std::cos(last_true_.yaw_rad), sin_true = std::sin(last_true_.yaw_rad);
  const double root_m = std::sqrt(way_m);
  const double noise_m = config_.translation_noise_m_per_sqrt_m * root_m * normal_(engine_);
  const double noise_rad = config_.yaw_noise_rad_per_sqrt_m * root_m * normal_(engine_);
  const double ahead_m = config_.translation_scale * (cos_true * dx_m + sin_true * dy_m) + noise_m;
  const double left_m = config_.translation_scale * (-sin_true * dx_m + cos_true * dy_m);
  const double turn_rad =
      config_.yaw_scale * true_turn_rad + config_.yaw_drift_rad_per_m * way_m + noise_rad;
  const double cos_odom = std::cos(odom_from_base_.yaw_rad);
  const double sin_odom = std::sin(odom_from_base_.yaw_rad);
  odom_from_base_.x_m += cos_odom * ahead_m - sin_odom * left_m;
  odom_from_base_.y_m += sin_odom * ahead_m + cos_odom * left_m;
  odom_from_base_.yaw_rad += turn_rad;
  last_true_ = map_from_base;
  return odom_from_base_;
}

}  // namespace soundmap::simulation
