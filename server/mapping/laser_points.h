#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "frames/frames.h"
#include "frames/odometry_track.h"
#include "geometry/pose.h"

namespace soundmap::mapping {

// What an LRF saw, in base_link at the middle of its sweep, seen from above.
struct LaserPoints {
  std::vector<Eigen::Vector2f> point_in_base;
  std::vector<std::uint16_t> beam;  // of each point
  // The LRF at the first and the last beam: the robot moves during the sweep.
  Eigen::Vector2f laser_begin_in_base = Eigen::Vector2f::Zero();
  Eigen::Vector2f laser_end_in_base = Eigen::Vector2f::Zero();
  int beams = 0;

  Eigen::Vector2f LaserInBase(std::size_t point) const {
    const float sweep = beams > 1 ? static_cast<float>(beam[point]) / (beams - 1) : 0.0f;
    return laser_begin_in_base + sweep * (laser_end_in_base - laser_begin_in_base);
  }
};

// Beams whose returns are in range; each is moved by the odometry between its own time and
// `reference_ns`. `lag_ns`: by how much the scan's stamps are later than the odometry's of the same
// moment. None if the track does not cover the sweep within 0.2 s.
std::optional<LaserPoints> PointsOf(const frames::LaserScan& scan,
                                    const frames::Calibration& calibration, double min_range_m,
                                    double max_range_m, const frames::OdometryTrack& track,
                                    frames::TimeNs lag_ns, frames::TimeNs reference_ns);

// The first point in each square of this size, in order.
std::vector<Eigen::Vector2f> FirstPointPerSquare(const std::vector<Eigen::Vector2f>& points,
                                                 float square_m);

}  // namespace soundmap::mapping
