#include "geometry/pose.h"

#include <cmath>

#include "geometry/angles.h"

namespace soundmap::geometry {

Pose2 Pose2::Inverse() const {
  const double c = std::cos(yaw_rad);
  const double s = std::sin(yaw_rad);
  return {-c * x_m - s * y_m, s * x_m - c * y_m, NormalizeAngle(-yaw_rad)};
}

Eigen::Isometry3d Pose2::ToIsometry() const {
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  transform.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  transform.translation() << x_m, y_m, 0.0;
  return transform;
}

Pose2 operator*(const Pose2& a_from_b, const Pose2& b_from_c) {
  const double c = std::cos(a_from_b.yaw_rad);
  const double s = std::sin(a_from_b.yaw_rad);
  return {a_from_b.x_m + c * b_from_c.x_m - s * b_from_c.y_m,
          a_from_b.y_m + s * b_from_c.x_m + c * b_from_c.y_m,
          NormalizeAngle(a_from_b.yaw_rad + b_from_c.yaw_rad)};
}

Pose2 ProjectToFloor(const Eigen::Isometry3d& target_from_source) {
  const Eigen::Matrix3d& rotation = target_from_source.linear();
  return {target_from_source.translation().x(), target_from_source.translation().y(),
          std::atan2(rotation(1, 0), rotation(0, 0))};
}

Pose2 Interpolate(const Pose2& begin, const Pose2& end, double fraction) {
  return {begin.x_m + fraction * (end.x_m - begin.x_m),
          begin.y_m + fraction * (end.y_m - begin.y_m),
          NormalizeAngle(begin.yaw_rad + fraction * NormalizeAngle(end.yaw_rad - begin.yaw_rad))};
}

}  // namespace soundmap::geometry
