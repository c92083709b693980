#include "mapping/laser_alignment.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"
#include "mapping/laser_search.h"
#include "mapping/planar_poses.h"

namespace soundmap::mapping {
namespace {

using frames::SecondsFromNs;
using frames::TimeNs;
using geometry::Pose2;

// Below this the search is widened.
constexpr double kGoodFit = 0.7;
constexpr double kGoodOverlap = 0.5;
constexpr double kWideSearch_m = 1.0;
// Of a larger step the odometry is not trusted to be near enough.
constexpr double kSmallStep_rad = 0.5;
constexpr double kSmallStep_s = 1.0;
constexpr double kWideSearch_rad = 0.35;
constexpr double kMaxWideSearch = 4.0;  // times as wide after scans that fitted nothing
constexpr double kWideSearchCell_m = 0.1;
constexpr double kMinScore = 0.5;
// How far a robot can be from where it would be had it gone on as before.
constexpr double kMaxCarryOn = 5.0;  // times the last step
constexpr TimeNs kBurst_ns = 1'000'000'000;
constexpr double kJolt_m = 0.15;
constexpr double kJolt_rad = 0.15;
constexpr double kMaxAcceleration_mps2 = 5.0;
constexpr double kMaxAcceleration_radps2 = 15.0;

// Odometry errs by this part of its step, and at least by the first figure.
constexpr double kPriorMin_m = 0.05;
constexpr double kPriorMin_rad = 0.02;
constexpr double kPriorOfStep = 0.2;

}  // namespace

double StepStd_m(double step_m) { return kPriorMin_m + kPriorOfStep * step_m; }
double StepStd_rad(double step_rad) { return kPriorMin_rad + kPriorOfStep * std::abs(step_rad); }

LaserMatch AlignToPath(const std::vector<Eigen::Vector2f>& point_in_base, const LineMap& lines,
                       const std::vector<LaserPathEntry>& path, int unregistered,
                       const Pose2& predicted, const Pose2& odom_from_base, TimeNs stamp_ns,
                       bool odometry_is_sound) {
  const LaserPathEntry& last = path.back();
  const double step_m = Distance(predicted, last.map_from_base);
  const double step_rad =
      std::abs(geometry::NormalizeAngle(predicted.yaw_rad - last.map_from_base.yaw_rad));
  const LaserSearchRange near{.start_distance_m = 0.3,
                              .prior_std_m = StepStd_m(step_m),
                              .prior_std_rad = StepStd_rad(step_rad)};
  // Where the robot would be if it had gone on as before. It cannot be far from there.
  const double duration_s = SecondsFromNs(stamp_ns - last.stamp_ns);
  Pose2 carried_on = last.map_from_base;
  if (path.size() >= 2) {
    const LaserPathEntry& before = path[path.size() - 2];
    const double fraction = duration_s / SecondsFromNs(last.stamp_ns - before.stamp_ns);
    if (fraction < kMaxCarryOn) {
      carried_on = last.map_from_base *
                   geometry::Interpolate(
                       Pose2{}, before.map_from_base.Inverse() * last.map_from_base, fraction);
    }
  }
  // Where the odometry of the last second puts it: odometry may come late and in bursts.
  std::size_t earlier = path.size() - 1;
  while (earlier > 0 && stamp_ns - path[earlier].stamp_ns < kBurst_ns) --earlier;
  const Pose2 over_a_second =
      path[earlier].map_from_base * path[earlier].odom_from_base.Inverse() * odom_from_base;
  const auto is_near = [squared_s2 = duration_s * duration_s](const Pose2& a, const Pose2& b) {
    const Pose2 off = a.Inverse() * b;
    return std::hypot(off.x_m, off.y_m) <= kJolt_m + kMaxAcceleration_mps2 * squared_s2 &&
           std::abs(off.yaw_rad) <= kJolt_rad + kMaxAcceleration_radps2 * squared_s2;
  };
  const auto is_possible = [&](const Pose2& map_from_base) {
    return unregistered > 0 || is_near(carried_on, map_from_base) ||
           (odometry_is_sound && is_near(predicted, map_from_base)) ||
           is_near(over_a_second, map_from_base);
  };
  const auto is_good = [&](const LaserMatch& match) {
    return match.fit() >= kGoodFit && match.overlap() >= kGoodOverlap &&
           is_possible(match.map_from_base);
  };
  LaserMatch best = MatchToLines(point_in_base, lines, predicted, near);
  const bool is_small = step_rad <= kSmallStep_rad && duration_s <= kSmallStep_s;
  if (odometry_is_sound && is_small && is_good(best)) return best;
  if (!is_possible(best.map_from_base)) best.inliers = 0;
  const auto try_also = [&](const Pose2& start, const LaserSearchRange& range) {
    const LaserMatch other = MatchToLines(point_in_base, lines, start, range);
    if (other.inliers > best.inliers * 5 / 4 && is_possible(other.map_from_base)) best = other;
  };
  // The odometry may have stopped, jumped or slipped, or catch up on what it had not told before.
  const LaserSearchRange wide{
      .start_distance_m = 0.5, .prior_std_m = kWideSearch_m, .prior_std_rad = kWideSearch_rad};
  for (const Pose2& start : {predicted, over_a_second, last.map_from_base, carried_on}) {
    try_also(start, wide);
  }
  if (is_small && is_good(best)) return best;
  std::vector<Eigen::Vector2f> means;
  for (const LinePiece& piece : lines.pieces()) means.push_back(piece.mean);
  const LaserSearch search(means, kWideSearchCell_m);
  const double growth = std::min(1.0 + 0.5 * unregistered, kMaxWideSearch);
  const auto found = search.Find(
      point_in_base, carried_on,
      {.distance_m = growth * kWideSearch_m, .angle_rad = growth * kWideSearch_rad}, kMinScore);
  if (found && found->unique) {
    try_also(
        found->map_from_base,
        {.start_distance_m = 0.3, .prior_std_m = kWideSearch_m, .prior_std_rad = kWideSearch_rad});
  }
  return best;
}

}  // namespace soundmap::mapping
