#pragma once

#include <array>
#include <deque>
#include <optional>

#include "frames/odometry_track.h"
#include "geometry/pose.h"

namespace soundmap::mapping {

// By how much the stamps of an LRF's scans are later than those of the odometry of the same moment,
// from how the robot turns: what the scans say of each turn is compared with what the odometry says
// of it for a row of lags. Memory is fixed.
class LaserLag {
 public:
  // A scan's heading in the map as aligned to what was mapped; stamps increase. `follows`: from the
  // scan before without a break.
  void Add(frames::TimeNs stamp_ns, double yaw_rad, bool follows);
  // To be called as the track grows.
  void Follow(const frames::OdometryTrack& track);

  // None until the robot has turned enough, and where the turns do not tell.
  std::optional<double> lag_s() const;

 private:
  static constexpr int kLags = 41;
  struct Turn {
    frames::TimeNs begin_ns = 0;
    frames::TimeNs end_ns = 0;
    double turn_rad = 0.0;
  };

  std::optional<Turn> last_;  // ends at the last scan
  std::deque<Turn> waiting_;  // for odometry
  std::array<double, kLags> squared_error_{};
  double turned_rad_ = 0.0;
};

}  // namespace soundmap::mapping
