#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "frames/odometry_track.h"
#include "localization/config.h"
#include "localization/pose_estimate.h"

namespace soundmap::localization {

struct Correction {
  PoseEstimate estimate;
  geometry::Pose2 odom_from_base;  // at the estimate's time
};

// The corrections of a drive and the odometry between them, as far back as they are wanted.
class PoseHistory {
 public:
  explicit PoseHistory(const MotionNoise& noise) : noise_(noise) {}

  bool Add(const frames::Odometry& odometry) { return track_.Add(odometry); }
  void Add(const Correction& correction) { corrections_.push_back(correction); }

  // Between two corrections both, carried there by odometry and weighted by time; after the newest
  // one that one, carried on; up to 1 s before the oldest that one. Else, and outside the odometry,
  // none.
  std::optional<PoseEstimate> At(frames::TimeNs time_ns) const;

  // From `begin_ns` on all corrections are of a lost robot.
  void MarkLost(frames::TimeNs begin_ns);
  // Those of these times (oldest first) instead of the ones in begin .. end.
  void Replace(frames::TimeNs begin_ns, frames::TimeNs end_ns,
               const std::vector<Correction>& corrections);

  // What At() does not need from `keep_ns` on goes, and the oldest corrections beyond `max_count`.
  // Odometry of a robot that stands is thinned.
  void Forget(frames::TimeNs keep_ns, std::size_t max_count);

  const frames::OdometryTrack& track() const { return track_; }
  const std::deque<Correction>& corrections() const { return corrections_; }
  std::size_t odometry_limit() const { return odometry_limit_; }
  void set_odometry_limit(std::size_t limit) { odometry_limit_ = limit; }

 private:
  MotionNoise noise_;
  frames::OdometryTrack track_{1e9};
  std::size_t odometry_limit_ = 0;  // entries at which the track is thinned next
  std::deque<Correction> corrections_;
};

}  // namespace soundmap::localization
