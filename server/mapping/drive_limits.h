#pragma once

#include <boost/unordered/unordered_flat_map.hpp>
#include <cstdint>

#include "frames/frames.h"
#include "geometry/pose.h"

namespace soundmap::mapping {

// Stamps up to the year 2116, so that sums of them do not overflow.
inline constexpr frames::TimeNs kMaxStamp_ns = frames::TimeNs{1} << 62;
inline bool IsStamp(frames::TimeNs stamp_ns) { return stamp_ns >= 0 && stamp_ns <= kMaxStamp_ns; }

// Beyond its ends odometry holds for so long.
inline constexpr double kHoldOdometry_s = 0.2;

// An LRF mounted lower than this is none.
inline constexpr double kMinLaserHeight_m = 0.05;

// What a robot can do; odometry that claims more is taken as a fault.
struct MotionLimits {
  double max_speed_mps = 4.0;
  double max_turn_rate_radps = 6.0;

  bool Allow(const geometry::Pose2& step, frames::TimeNs duration_ns) const;
};

// Keeps what is kept of a building from growing with the drive: each square metre and quarter turn
// has room for so many scans.
class KeyScanPlaces {
 public:
  explicit KeyScanPlaces(int scans_per_place) : scans_per_place_(scans_per_place) {}

  // Whether there is room, which is taken.
  bool Take(const geometry::Pose2& map_from_base);

 private:
  int scans_per_place_;
  boost::unordered_flat_map<std::int64_t, int> taken_;
};

}  // namespace soundmap::mapping
