#pragma once

#include <Eigen/Core>

#include "frames/frames.h"
#include "geometry/pose.h"

namespace soundmap::localization {

enum class State { kTracking, kUncertain, kLost };

// Where the robot was at `stamp_ns`.
struct PoseEstimate {
  frames::TimeNs stamp_ns = 0;
  geometry::Pose2 map_from_base;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  // of x_m, y_m, yaw_rad
  double effective_particles = 0.0;                      // N_eff
  double scan_fit = 0.0;  // share of valid beams that the map explains, 0 .. 1
  State state = State::kUncertain;
};

// Where the frame of a robot's odometry, as the robot sends it, lay in the map at `stamp_ns`: until
// the next correction it carries later odometry into the map.
struct OdometryFrame {
  frames::TimeNs stamp_ns = 0;
  geometry::Pose2 map_from_odom;
};

}  // namespace soundmap::localization
