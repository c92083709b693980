#include "mapping/surveyed_poses.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "mapping/drive_limits.h"
#include "mapping/planar_poses.h"

namespace soundmap::mapping {

using frames::TimeNs;
using geometry::Pose2;

Pose2 Between(const Pose2& map_from_begin, const Pose2& odom_from_begin, const Pose2& map_from_end,
              const Pose2& odom_from_end, const Pose2& odom_from_base, double fraction) {
  const Pose2 map_from_odom = map_from_begin * odom_from_begin.Inverse();
  const Pose2 left = (map_from_odom * odom_from_end).Inverse() * map_from_end;
  return map_from_odom * odom_from_base * geometry::Interpolate(Pose2{}, left, fraction);
}

absl::StatusOr<SurveyedPoses> SurveyedPoses::Create(std::vector<StampedPose> poses) {
  if (poses.size() == 1) {
    return absl::InvalidArgumentError("one surveyed pose does not place a drive; two or more do");
  }
  SurveyedPoses surveyed;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (!IsFinite(poses[i].map_from_base) || !IsStamp(poses[i].stamp_ns)) {
      return absl::InvalidArgumentError(
          absl::StrCat("the surveyed pose ", i, " is not finite or its time is out of range"));
    }
    if (i > 0 && poses[i].stamp_ns <= poses[i - 1].stamp_ns) {
      return absl::InvalidArgumentError(
          absl::StrCat("the surveyed pose ", i, " is not later than the one before"));
    }
    surveyed.poses_.push_back({poses[i], std::nullopt});
  }
  return surveyed;
}

void SurveyedPoses::Follow(const frames::OdometryTrack& track) {
  if (track.empty()) return;
  while (followed_ < poses_.size() && poses_[followed_].pose.stamp_ns <= track.newest_ns()) {
    Entry& entry = poses_[followed_++];
    entry.odom_from_base = track.Near(entry.pose.stamp_ns, kHoldOdometry_s);
  }
}

std::optional<Pose2> SurveyedPoses::At(TimeNs stamp_ns, const Pose2& odom_from_base) const {
  const auto after =
      std::lower_bound(poses_.begin(), poses_.end(), stamp_ns,
                       [](const Entry& entry, TimeNs ns) { return entry.pose.stamp_ns < ns; });
  if (after == poses_.end()) return std::nullopt;
  if (after->pose.stamp_ns == stamp_ns) return after->pose.map_from_base;
  if (after == poses_.begin()) return std::nullopt;
  const Entry& begin = *std::prev(after);
  const Entry& end = *after;
  const double fraction = static_cast<double>(stamp_ns - begin.pose.stamp_ns) /
                          static_cast<double>(end.pose.stamp_ns - begin.pose.stamp_ns);
  if (!begin.odom_from_base || !end.odom_from_base) {
    return geometry::Interpolate(begin.pose.map_from_base, end.pose.map_from_base, fraction);
  }
  return Between(begin.pose.map_from_base, *begin.odom_from_base, end.pose.map_from_base,
                 *end.odom_from_base, odom_from_base, fraction);
}

}  // namespace soundmap::mapping
