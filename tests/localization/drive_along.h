#pragma once

#include <vector>

#include "synthetic_room.h"

namespace soundmap::localization {

// A drive along straight lines at 0.5 m/s, with turns on the spot at 1 rad/s between them.
class DriveAlong {
 public:
  DriveAlong(SyntheticRoom room, const std::vector<Eigen::Vector2d>& waypoints);

  geometry::Pose2 TruthAt(double time_s) const;
  double duration_s() const { return leg_ends_s_.back(); }

  // Odometry at 20 Hz with 2 % of error in the way and 1 degree a metre, scans at 10 Hz; stamps
  // from `begin_ns` on, odometry from `odom_from_base` on, which is left at where it ends.
  std::vector<frames::Frame> Frames(frames::TimeNs begin_ns, geometry::Pose2& odom_from_base,
                                    std::mt19937_64& engine) const;

 private:
  SyntheticRoom room_;
  std::vector<geometry::Pose2> leg_begins_;  // each leg is a turn or a straight drive
  std::vector<geometry::Pose2> leg_steps_;   // to its end
  std::vector<double> leg_ends_s_;
};

}  // namespace soundmap::localization
