#pragma once

#include <span>

#include "geometry/pose.h"

namespace soundmap::mapping {

// What a drive's odometry must be multiplied by: the part of its errors that comes from the radius
// and the distance of the wheels, and so stays the same over the drive.
struct OdometryScale {
  double translation = 1.0;
  double rotation = 1.0;

  geometry::Pose2 Corrected(const geometry::Pose2& step) const {
    return {translation * step.x_m, translation * step.y_m, rotation * step.yaw_rad};
  }
};

// A place of the drive by its odometry, and as it was mapped.
struct MappedOdometry {
  geometry::Pose2 odom_from_base;
  geometry::Pose2 map_from_base;
};

// By least squares over the steps of the drive. A scale of which the drive says too little, or too
// much for wheels that do not slip, is 1.
OdometryScale ScaleOf(std::span<const MappedOdometry> drive);

}  // namespace soundmap::mapping
