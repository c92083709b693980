#pragma once

#include <Eigen/Geometry>
#include <cmath>

#include "geometry/pose.h"

namespace soundmap::mapping {

inline bool IsFinite(const geometry::Pose2& pose) {
  return std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.yaw_rad);
}

inline double Distance(const geometry::Pose2& a, const geometry::Pose2& b) {
  return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m);
}

inline Eigen::Isometry2f InPlane(const geometry::Pose2& pose) {
  return Eigen::Translation2f(static_cast<float>(pose.x_m), static_cast<float>(pose.y_m)) *
         Eigen::Rotation2Df(static_cast<float>(pose.yaw_rad));
}

}  // namespace soundmap::mapping
