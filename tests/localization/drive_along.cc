#include "drive_along.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

using geometry::Pose2;

constexpr double kSpeed_mps = 0.5;
constexpr double kTurnRate_radps = 1.0;

}  // namespace

DriveAlong::DriveAlong(SyntheticRoom room, const std::vector<Eigen::Vector2d>& waypoints)
    : room_(std::move(room)) {
  double now_s = 0.0;
  double yaw_rad = 0.0;
  for (std::size_t i = 1; i < waypoints.size(); ++i) {
    const Eigen::Vector2d way = waypoints[i] - waypoints[i - 1];
    const double heading_rad = std::atan2(way.y(), way.x());
    if (i == 1) yaw_rad = heading_rad;
    const double turn_rad = geometry::NormalizeAngle(heading_rad - yaw_rad);
    if (turn_rad != 0.0) {
      leg_begins_.push_back({waypoints[i - 1].x(), waypoints[i - 1].y(), yaw_rad});
      leg_steps_.push_back({0.0, 0.0, turn_rad});
      leg_ends_s_.push_back(now_s += std::abs(turn_rad) / kTurnRate_radps);
    }
    leg_begins_.push_back({waypoints[i - 1].x(), waypoints[i - 1].y(), heading_rad});
    leg_steps_.push_back({way.norm(), 0.0, 0.0});
    leg_ends_s_.push_back(now_s += way.norm() / kSpeed_mps);
    yaw_rad = heading_rad;
  }
}

Pose2 DriveAlong::TruthAt(double time_s) const {
  std::size_t leg = 0;
  while (leg + 1 < leg_ends_s_.size() && leg_ends_s_[leg] < time_s) ++leg;
  const double begin_s = leg == 0 ? 0.0 : leg_ends_s_[leg - 1];
  const double share = std::clamp((time_s - begin_s) / (leg_ends_s_[leg] - begin_s), 0.0, 1.0);
  const Pose2& step = leg_steps_[leg];
  return leg_begins_[leg] * Pose2{share * step.x_m, share * step.y_m, share * step.yaw_rad};
}

std::vector<frames::Frame> DriveAlong::Frames(frames::TimeNs begin_ns, Pose2& odom_from_base,
                                              std::mt19937_64& engine) const {
  std::normal_distribution<double> normal;
  std::vector<frames::Frame> frames;
  const int steps = static_cast<int>(duration_s() * 20.0);
  for (int i = 0; i <= steps; ++i) {
    const frames::TimeNs stamp_ns = begin_ns + i * 50'000'000LL;
    if (i > 0) {
      const Pose2 step = TruthAt((i - 1) / 20.0).Inverse() * TruthAt(i / 20.0);
      odom_from_base = odom_from_base * Pose2{1.02 * step.x_m, step.y_m,
                                              step.yaw_rad + geometry::RadFromDeg(1.0) * step.x_m +
                                                  0.0005 * normal(engine)};
    }
    frames.emplace_back(frames::Odometry{stamp_ns, odom_from_base});
    if (i % 2 == 0) frames.emplace_back(ScanAt(room_, TruthAt(i / 20.0), stamp_ns, 0.01, engine));
  }
  return frames;
}

}  // namespace soundmap::localization
