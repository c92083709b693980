#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/odometry_track.h"
#include "geometry/pose.h"
#include "mapping/mapper.h"

namespace soundmap::mapping {

// A robot's poses at some times, surveyed or computed elsewhere, and its odometry between them.
// Times are those of the scans.
class SurveyedPoses {
 public:
  SurveyedPoses() = default;  // none

  // None, or two or more with times increasing; otherwise InvalidArgument.
  static absl::StatusOr<SurveyedPoses> Create(std::vector<StampedPose> poses);

  bool empty() const { return poses_.empty(); }

  // To be called as the track grows: takes the odometry at the surveyed times that it has reached.
  void Follow(const frames::OdometryTrack& track);

  // map_from_base. Between two surveyed poses the robot moves as its odometry says, and what is
  // left at the second is spread over the way in time; without odometry at either, the way is
  // straight. None outside their span.
  std::optional<geometry::Pose2> At(frames::TimeNs stamp_ns,
                                    const geometry::Pose2& odom_from_base) const;

 private:
  struct Entry {
    StampedPose pose;
    std::optional<geometry::Pose2> odom_from_base;
  };

  std::vector<Entry> poses_;
  std::size_t followed_ = 0;
};

// Moves as the odometry says from `begin`, where it said `odom_from_begin`, such that `end` is
// reached where it said `odom_from_end`; `fraction` of what is left there has been added by now.
geometry::Pose2 Between(const geometry::Pose2& map_from_begin,
                        const geometry::Pose2& odom_from_begin, const geometry::Pose2& map_from_end,
                        const geometry::Pose2& odom_from_end, const geometry::Pose2& odom_from_base,
                        double fraction);

}  // namespace soundmap::mapping
