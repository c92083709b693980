#pragma once

#include <Eigen/Core>
#include <random>

#include "geometry/pose.h"
#include "localization/config.h"

namespace soundmap::localization {

// The odometry motion model of Probabilistic Robotics, section 5.4: the motion between two odometry
// poses is a turn, a straight drive and a turn, each with noise of its own. Deviations: driving
// backwards is a negative drive, not two half turns; when the robot stood still, all of the turn is
// the second one; a drive across takes part through the floor of the noise.
class MotionModel {
 public:
  // `begin_from_end`: the pose of base_link at the end of the motion in base_link at its begin, by
  // the odometry.
  MotionModel(const MotionNoise& noise, const geometry::Pose2& begin_from_end);

  // map_from_base at the end of the motion, drawn for one particle.
  geometry::Pose2 Sample(const geometry::Pose2& map_from_base, std::mt19937_64& engine) const;

  // Covariance (x_m, y_m, yaw_rad in `map`) at the end, to first order, from that at the begin.
  Eigen::Matrix3d Propagate(const geometry::Pose2& map_from_base,
                            const Eigen::Matrix3d& covariance) const;

  double first_turn_rad() const { return first_turn_rad_; }
  double drive_m() const { return drive_m_; }
  double second_turn_rad() const { return second_turn_rad_; }
  double first_turn_std_rad() const { return first_turn_std_rad_; }
  double drive_std_m() const { return drive_std_m_; }
  double across_std_m() const { return across_std_m_; }
  double second_turn_std_rad() const { return second_turn_std_rad_; }

 private:
  double first_turn_rad_;
  double drive_m_;
  double second_turn_rad_;
  double first_turn_std_rad_;
  double drive_std_m_;
  double across_std_m_;
  double second_turn_std_rad_;
};

}  // namespace soundmap::localization
