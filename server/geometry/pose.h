#pragma once

#include <Eigen/Geometry>

namespace soundmap::geometry {

// A pose on the flat floor (section II-A: z, pitch and roll are constant). As a transform it is
// named target_from_source.
struct Pose2 {
  double x_m = 0.0;
  double y_m = 0.0;
  double yaw_rad = 0.0;  // counter-clockwise from x

  Pose2 Inverse() const;
  // In space, at z = 0.
  Eigen::Isometry3d ToIsometry() const;
  bool operator==(const Pose2&) const = default;
};

// a_from_c = a_from_b * b_from_c; yaw stays in (-pi, pi].
Pose2 operator*(const Pose2& a_from_b, const Pose2& b_from_c);

// x, y and yaw of a transform; z, pitch and roll are dropped.
Pose2 ProjectToFloor(const Eigen::Isometry3d& target_from_source);

// Between two poses: position linear, yaw along the shorter arc. fraction 0 gives `begin`, 1 gives
// `end`.
Pose2 Interpolate(const Pose2& begin, const Pose2& end, double fraction);

}  // namespace soundmap::geometry
