#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "soundmap/poses.h"

namespace soundmap::cli {

// The shorter way round: in (-pi, pi].
double WrapAngle(double angle_rad);

// A path through given poses: positions linear between them, yaw along the shorter arc.
class PoseTrack {
 public:
  // Sorted by time here.
  explicit PoseTrack(std::vector<StampedPose> poses);

  // None outside the path (1 ms at its ends is forgiven: files round their times), or between poses
  // more than `max_gap_ns` apart.
  std::optional<Pose2> At(std::int64_t time_ns, std::int64_t max_gap_ns = INT64_MAX) const;

  const std::vector<StampedPose>& poses() const { return poses_; }

 private:
  std::vector<StampedPose> poses_;
};

}  // namespace soundmap::cli
