#pragma once

#include <array>
#include <deque>
#include <optional>

#include "frames/odometry_track.h"
#include "geometry/pose.h"

namespace soundmap::frames {

// By how much the stamps of an LRF's scans are later than those of the odometry of the same moment,
// from how the robot turns: what the scans say of each turn is compared with what the odometry says
// of it for a row of lags. Memory is fixed.
class LaserLag {
 public:
  static constexpr int kLags = 41;
  struct Turn {
    TimeNs begin_ns = 0;
    TimeNs end_ns = 0;
    double turn_rad = 0.0;

    bool operator==(const Turn&) const = default;
  };
  // All that a LaserLag remembers.
  struct State {
    std::optional<Turn> last;  // ends at the last scan; its turn is the scan's heading
    std::deque<Turn> waiting;  // for odometry
    std::array<double, kLags> squared_error{};
    std::int64_t turns = 0;  // that the errors are of
    double turned_rad = 0.0;

    bool operator==(const State&) const = default;
  };

  // A scan's heading in the map as aligned to what was mapped; stamps increase.
  void Add(TimeNs stamp_ns, double yaw_rad);
  // What the next scan says does not follow from the one before.
  void Break() { state_.last.reset(); }
  // To be called as the track grows.
  void Follow(const OdometryTrack& track);

  // None until the turns tell it with this standard deviation.
  std::optional<double> lag_s(double max_std_s) const;

  const State& state() const { return state_; }
  // False, and no change, when it cannot be one of a LaserLag.
  bool Restore(const State& state);

 private:
  State state_;
};

}  // namespace soundmap::frames
