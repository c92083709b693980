#pragma once

#include <vector>

#include "frames/odometry_track.h"

namespace soundmap::localization {

// A beam with a return, projected to the floor.
struct Beam {
  Eigen::Vector2d origin_in_base_m;
  Eigen::Vector2d direction_in_base;  // unit vector
  double range_m;                     // along the floor
};

// Middle of the scan's sweep on the odometry's clock.
frames::TimeNs MiddleOf(const frames::LaserScan& scan, double time_increment_s, double lag_s);

// The valid beams of a scan in base_link at the middle of its sweep; with a time increment each is
// moved by the odometry between its own time and the middle. A reading that is not finite or below
// `min_range_m` is no return. None while the odometry does not reach over the sweep.
std::optional<std::vector<Beam>> ValidBeams(const frames::LaserScan& scan,
                                            const frames::Calibration& calibration, double lag_s,
                                            double min_range_m, const frames::OdometryTrack& track);

// `count` of them, evenly spread over the valid ones; all when there are fewer.
std::vector<Beam> Subsample(const std::vector<Beam>& beams, int count);

}  // namespace soundmap::localization
