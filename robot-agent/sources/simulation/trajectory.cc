#include "sources/simulation/trajectory.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace soundmap::simulation {
namespace {

constexpr double kStepM = 0.01;  // spacing of the knots along the line
constexpr double kSlowestMps =
    0.01;  // at the ends: a speed of zero would never leave the first knot
constexpr double kLongestDriveS = 86400.0;
constexpr double kLongestPathM = 50000.0;

struct LinePoint {
  Eigen::Vector2d position_m;
  double speed_mps;
};

// The polygon, sampled each kStepM or a little less.
std::vector<LinePoint> SamplePolygon(const PathConfig& path) {
  std::vector<LinePoint> line;
  const int count = static_cast<int>(path.way_points_m.size());
  const int segments = path.closed ? count : count - 1;
  for (int i = 0; i < segments; ++i) {
    const Eigen::Vector2d from = path.way_points_m[i];
    const Eigen::Vector2d to = path.way_points_m[(i + 1) % count];
    const int steps = std::max(1, static_cast<int>(std::ceil((to - from).norm() / kStepM)));
    for (int k = 0; k < steps; ++k) {
      line.push_back({from + (to - from) * (static_cast<double>(k) / steps), path.speed_mps[i]});
    }
  }
  if (!path.closed) line.push_back({path.way_points_m.back(), path.speed_mps.back()});
  return line;
}

// Average over `window` points around each; an open line's window shrinks towards its ends, which
// stay where they are.
std::vector<LinePoint> Smooth(const std::vector<LinePoint>& line, int window, bool closed) {
  const int count = static_cast<int>(line.size());
  std::vector<LinePoint> smooth(line.size());
  for (int i = 0; i < count; ++i) {
    int half = window / 2;
    if (!closed) half = std::min({half, i, count - 1 - i});
    LinePoint sum{Eigen::Vector2d::Zero(), 0.0};
    for (int k = i - half; k <= i + half; ++k) {
      const auto& point = line[((k % count) + count) % count];
      sum.position_m += point.position_m;
      sum.speed_mps += point.speed_mps;
    }
    smooth[i] = {sum.position_m / (2 * half + 1), sum.speed_mps / (2 * half + 1)};
  }
  return smooth;
}

}  // namespace

Eigen::Isometry3d PlanarPose::map_from_base() const {
  return Eigen::Translation3d(x_m, y_m, 0.0) *
         Eigen::Isometry3d(Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()));
}

absl::StatusOr<Trajectory> Trajectory::Create(const PathConfig& path, double laps) {
  if (path.way_points_m.empty() || path.speed_mps.size() != path.way_points_m.size()) {
    return absl::InvalidArgumentError("a path needs way points and a speed for each of them");
  }
  Trajectory trajectory;
  if (path.way_points_m.size() == 1) {
    if (!(path.standing_s > 0.0 && path.standing_s <= kLongestDriveS)) {
      return absl::InvalidArgumentError("a path of one way point needs standing_s");
    }
    const Eigen::Vector2d position_m = path.way_points_m.front();
    trajectory.knots_ = {{0.0, {position_m.x(), position_m.y(), path.standing_yaw_rad}, 0.0}};
    trajectory.duration_s_ = path.standing_s;
    return trajectory;
  }
  double length_m = 0.0;
  for (std::size_t i = 0; i < path.way_points_m.size(); ++i) {
    length_m +=
        (path.way_points_m[(i + 1) % path.way_points_m.size()] - path.way_points_m[i]).norm();
  }
  if (!(length_m * std::max(laps, 1.0) <= kLongestPathM && laps > 0.0)) {
    return absl::InvalidArgumentError("the path is longer than 50 km");
  }
  std::vector<LinePoint> line = SamplePolygon(path);
  if (line.size() < 3 || length_m < 3.0 * kStepM) {
    return absl::InvalidArgumentError("the path's way points lie on each other");
  }
  const int window =
      std::min(static_cast<int>(path.turn_smoothing_m / kStepM), static_cast<int>(line.size()) / 2);
  for (int pass = 0; pass < 3; ++pass) line = Smooth(line, window, path.closed);

  // All laps as one open line of knots with arc lengths and headings.
  const int lap = static_cast<int>(line.size());
  const int count = path.closed ? static_cast<int>(std::lround(lap * laps)) + 1 : lap;
  std::vector<double> arc_m(count, 0.0), heading_rad(count, 0.0), speed_mps(count, 0.0);
  const auto at = [&](int i) -> const LinePoint& {
    return path.closed ? line[((i % lap) + lap) % lap] : line[std::clamp(i, 0, lap - 1)];
  };
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector2d along = at(i + 1).position_m - at(i - 1).position_m;
    const double heading = std::atan2(along.y(), along.x());
    if (i == 0) {
      heading_rad[i] = heading;
      continue;
    }
    heading_rad[i] =
        heading_rad[i - 1] + std::remainder(heading - heading_rad[i - 1], 2.0 * std::numbers::pi);
    arc_m[i] = arc_m[i - 1] + (at(i).position_m - at(i - 1).position_m).norm();
  }
  for (int i = 0; i < count; ++i) {
    const int before = std::max(0, i - 1), after = std::min(count - 1, i + 1);
    const double turn_rad = std::abs(heading_rad[after] - heading_rad[before]);
    const double step_m = std::max(arc_m[after] - arc_m[before], 1e-6);
    speed_mps[i] = std::max(
        kSlowestMps,
        std::min(at(i).speed_mps, path.max_yaw_rate_radps * step_m / std::max(turn_rad, 1e-9)));
  }
  speed_mps.front() = speed_mps.back() = kSlowestMps;
  const auto reachable = [&](int from, int to) {
    return std::sqrt(speed_mps[from] * speed_mps[from] +
                     2.0 * path.acceleration_mps2 * std::abs(arc_m[to] - arc_m[from]));
  };
  for (int i = 1; i < count; ++i) speed_mps[i] = std::min(speed_mps[i], reachable(i - 1, i));
  for (int i = count - 2; i >= 0; --i) speed_mps[i] = std::min(speed_mps[i], reachable(i + 1, i));

  double time_s = 0.0;
  for (int i = 0; i < count; ++i) {
    if (i > 0) time_s += 2.0 * (arc_m[i] - arc_m[i - 1]) / (speed_mps[i] + speed_mps[i - 1]);
    const Eigen::Vector2d position_m = at(i).position_m;
    trajectory.knots_.push_back(
        {time_s, {position_m.x(), position_m.y(), heading_rad[i]}, speed_mps[i]});
  }
  if (!(time_s <= kLongestDriveS)) return absl::InvalidArgumentError("the drive exceeds a day");
  trajectory.duration_s_ = time_s;
  return trajectory;
}

PlanarPose Trajectory::At(double time_s) const {
  const auto after =
      std::upper_bound(knots_.begin(), knots_.end(), time_s,
                       [](double time, const Knot& knot) { return time < knot.time_s; });
  if (after == knots_.begin()) return knots_.front().pose;
  if (after == knots_.end()) return knots_.back().pose;
  const Knot& a = *(after - 1);
  const Knot& b = *after;
  const double part = (time_s - a.time_s) / (b.time_s - a.time_s);
  const double share =
      part * (2.0 * a.speed_mps + part * (b.speed_mps - a.speed_mps)) / (a.speed_mps + b.speed_mps);
  return {a.pose.x_m + share * (b.pose.x_m - a.pose.x_m),
          a.pose.y_m + share * (b.pose.y_m - a.pose.y_m),
          a.pose.yaw_rad + share * (b.pose.yaw_rad - a.pose.yaw_rad)};
}

}  // namespace soundmap::simulation
