#include "localization/pose_history.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"
#include "localization/motion_model.h"

namespace soundmap::localization {
namespace {

// So long before the first correction the pose is carried back to.
constexpr double kBeforeFirst_s = 1.0;

// So far apart the odometry does not lead from one correction to the next: the robot was carried.
constexpr double kCarried_m = 0.5;
constexpr double kCarried_rad = 0.3;

// Odometry entries that the track holds before it is looked through for what can go.
constexpr std::size_t kMinOdometryLimit = 2048;

// An entry this near the line between its neighbours says nothing.
constexpr double kStraight_m = 5e-4;
constexpr double kStraight_rad = 5e-4;

bool Says(const frames::Odometry& before, const frames::Odometry& entry,
          const frames::Odometry& after) {
  const double fraction = static_cast<double>(entry.stamp_ns - before.stamp_ns) /
                          static_cast<double>(after.stamp_ns - before.stamp_ns);
  const geometry::Pose2 between =
      geometry::Interpolate(before.odom_from_base, after.odom_from_base, fraction);
  const geometry::Pose2 off = between.Inverse() * entry.odom_from_base;
  return std::hypot(off.x_m, off.y_m) > kStraight_m || std::abs(off.yaw_rad) > kStraight_rad;
}

// Without the entries that lie on the line between the last one taken and the next one, as long as
// the robot stands: a line never spans a motion, so that errors do not add up.
frames::OdometryTrack Thinned(const std::deque<frames::Odometry>& entries, std::size_t first) {
  frames::OdometryTrack thinned(1e9);
  std::size_t last = first;
  thinned.Add(entries[first]);
  for (std::size_t i = first + 1; i < entries.size(); ++i) {
    const geometry::Pose2 moved =
        entries[last].odom_from_base.Inverse() * entries[i].odom_from_base;
    const bool stands =
        std::hypot(moved.x_m, moved.y_m) <= kStraight_m && std::abs(moved.yaw_rad) <= kStraight_rad;
    if (stands && i + 1 < entries.size() && !Says(entries[last], entries[i], entries[i + 1])) {
      continue;
    }
    thinned.Add(entries[i]);
    last = i;
  }
  return thinned;
}

}  // namespace

std::optional<PoseEstimate> PoseHistory::At(frames::TimeNs time_ns) const {
  const auto odom_from_base = track_.At(time_ns);
  if (!odom_from_base || corrections_.empty()) return std::nullopt;
  const auto carried = [&](const Correction& correction) {
    return correction.estimate.map_from_base *
           (correction.odom_from_base.Inverse() * *odom_from_base);
  };
  const auto after = std::lower_bound(corrections_.begin(), corrections_.end(), time_ns,
                                      [](const Correction& c, frames::TimeNs wanted_ns) {
                                        return c.estimate.stamp_ns < wanted_ns;
                                      });

  if (after == corrections_.end()) {
    const Correction& newest = corrections_.back();
    PoseEstimate estimate = newest.estimate;
    estimate.map_from_base = carried(newest);
    estimate.covariance = MotionModel(noise_, newest.odom_from_base.Inverse() * *odom_from_base)
                              .Propagate(newest.estimate.map_from_base, newest.estimate.covariance);
    estimate.stamp_ns = time_ns;
    return estimate;
  }
  if (after == corrections_.begin()) {
    const double before_s = frames::SecondsFromNs(after->estimate.stamp_ns - time_ns);
    if (before_s > kBeforeFirst_s) return std::nullopt;
    PoseEstimate estimate = after->estimate;
    estimate.map_from_base = carried(*after);
    estimate.stamp_ns = time_ns;
    return estimate;
  }
  const Correction& before = *std::prev(after);
  const double fraction = static_cast<double>(time_ns - before.estimate.stamp_ns) /
                          static_cast<double>(after->estimate.stamp_ns - before.estimate.stamp_ns);
  const geometry::Pose2 map_from_base_before = carried(before);
  const geometry::Pose2 map_from_base_after = carried(*after);
  PoseEstimate estimate;
  estimate.stamp_ns = time_ns;
  estimate.map_from_base =
      geometry::Interpolate(map_from_base_before, map_from_base_after, fraction);
  estimate.covariance =
      (1.0 - fraction) * before.estimate.covariance + fraction * after->estimate.covariance;
  estimate.effective_particles =
      std::min(before.estimate.effective_particles, after->estimate.effective_particles);
  estimate.scan_fit = std::min(before.estimate.scan_fit, after->estimate.scan_fit);
  estimate.state = std::max(before.estimate.state, after->estimate.state);
  const geometry::Pose2 gap = map_from_base_before.Inverse() * map_from_base_after;
  if (std::hypot(gap.x_m, gap.y_m) > kCarried_m || std::abs(gap.yaw_rad) > kCarried_rad) {
    estimate.state = State::kLost;
  }
  return estimate;
}

void PoseHistory::MarkLost(frames::TimeNs begin_ns) {
  for (auto correction = corrections_.rbegin();
       correction != corrections_.rend() && correction->estimate.stamp_ns >= begin_ns;
       ++correction) {
    correction->estimate.state = State::kLost;
  }
}

void PoseHistory::Replace(frames::TimeNs begin_ns, frames::TimeNs end_ns,
                          const std::vector<Correction>& corrections) {
  std::deque<Correction> replaced;
  for (const Correction& correction : corrections_) {
    if (correction.estimate.stamp_ns < begin_ns) replaced.push_back(correction);
  }
  replaced.insert(replaced.end(), corrections.begin(), corrections.end());
  for (const Correction& correction : corrections_) {
    if (correction.estimate.stamp_ns > end_ns) replaced.push_back(correction);
  }
  corrections_ = std::move(replaced);
}

void PoseHistory::Forget(frames::TimeNs keep_ns, std::size_t max_count) {
  while (corrections_.size() > 2 &&
         (corrections_[1].estimate.stamp_ns < keep_ns || corrections_.size() > max_count)) {
    corrections_.pop_front();
  }
  const std::deque<frames::Odometry>& entries = track_.entries();
  if (entries.size() < std::max(odometry_limit_, kMinOdometryLimit)) return;
  if (corrections_.size() >= max_count) {
    keep_ns = std::max(keep_ns, corrections_.front().estimate.stamp_ns);
  }
  std::size_t first = 0;
  while (first + 2 < entries.size() && entries[first + 1].stamp_ns < keep_ns) ++first;
  track_ = Thinned(entries, first);
  odometry_limit_ = 2 * track_.entries().size();
}

}  // namespace soundmap::localization
