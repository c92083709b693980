#include "tests/mapping/laser_world.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "geometry/angles.h"

namespace soundmap::mapping {
namespace {

using Eigen::Vector2d;
using geometry::Pose2;

double Cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

// Straight ways and turns on the spot, by time.
class Route {
 public:
  explicit Route(const LaserDriveModel& model) {
    double yaw = 0.0;
    for (std::size_t i = 0; i + 1 < model.corners.size(); ++i) {
      const Vector2d way = model.corners[i + 1] - model.corners[i];
      const double next_yaw = std::atan2(way.y(), way.x());
      if (i == 0) yaw = next_yaw;
      const double turn = geometry::NormalizeAngle(next_yaw - yaw);
      Add(model.corners[i], model.corners[i], yaw, turn, std::abs(turn) / model.turn_rate_radps);
      yaw = next_yaw;
      Add(model.corners[i], model.corners[i + 1], yaw, 0.0, way.norm() / model.speed_mps);
    }
  }

  double duration_s() const { return end_s_; }
  Pose2 At(double time_s) const {
    for (const Leg& leg : legs_) {
      if (time_s > leg.begin_s + leg.duration_s && &leg != &legs_.back()) continue;
      const double u = std::clamp((time_s - leg.begin_s) / leg.duration_s, 0.0, 1.0);
      const Vector2d place = leg.begin + u * (leg.end - leg.begin);
      return {place.x(), place.y(), geometry::NormalizeAngle(leg.yaw + u * leg.turn)};
    }
    return {};
  }

 private:
  struct Leg {
    double begin_s, duration_s;
    Vector2d begin, end;
    double yaw, turn;
  };
  void Add(const Vector2d& begin, const Vector2d& end, double yaw, double turn, double duration_s) {
    if (!(duration_s > 1e-9)) return;
    legs_.push_back({end_s_, duration_s, begin, end, yaw, turn});
    end_s_ += duration_s;
  }
  std::vector<Leg> legs_;
  double end_s_ = 0.0;
};

constexpr frames::TimeNs kStart_ns = 1'700'000'000'000'000'000;
frames::TimeNs At(double time_s) { return kStart_ns + std::llround(time_s * 1e9); }

}  // namespace

void LaserWorld::AddBox(const Vector2d& low, const Vector2d& high) {
  const Vector2d right(high.x(), low.y()), left(low.x(), high.y());
  AddWall(low, right);
  AddWall(right, high);
  AddWall(high, left);
  AddWall(left, low);
}

double LaserWorld::Range(const Vector2d& origin, double angle_rad) const {
  const Vector2d direction(std::cos(angle_rad), std::sin(angle_rad));
  double nearest = std::numeric_limits<double>::infinity();
  for (const Wall& wall : walls_) {
    const Vector2d along = wall.end - wall.begin;
    const double denominator = Cross(direction, along);
    if (std::abs(denominator) < 1e-12) continue;
    const double range = Cross(wall.begin - origin, along) / denominator;
    const double share = Cross(wall.begin - origin, direction) / denominator;
    if (range > 0.0 && share >= 0.0 && share <= 1.0) nearest = std::min(nearest, range);
  }
  return nearest;
}

double LaserWorld::DistanceToWall(const Vector2d& point) const {
  double nearest = std::numeric_limits<double>::infinity();
  for (const Wall& wall : walls_) {
    const Vector2d along = wall.end - wall.begin;
    const double share =
        std::clamp((point - wall.begin).dot(along) / along.squaredNorm(), 0.0, 1.0);
    nearest = std::min(nearest, (point - wall.begin - share * along).norm());
  }
  return nearest;
}

LaserWorld FurnishedHall() {
  LaserWorld world;
  world.AddBox({0, 0}, {9, 7});
  world.AddBox({8.0, 0.0}, {9.0, 2.5});
  world.AddBox({4.2, 3.2}, {4.7, 3.7});
  world.AddBox({0.0, 5.5}, {1.5, 7.0});
  return world;
}

LaserWorld CorridorsAroundABlock() {
  LaserWorld world;
  // Doors set back by 0.3 m, at distances that do not repeat.
  const auto wall = [&world](const Vector2d& begin, const Vector2d& end, const Vector2d& back,
                             std::vector<double> doors) {
    const Vector2d along = (end - begin).normalized();
    Vector2d at = begin;
    for (const double door : doors) {
      const Vector2d left = begin + door * along, right = left + 0.9 * along;
      world.AddWall(at, left);
      world.AddWall(left, left + 0.3 * back);
      world.AddWall(left + 0.3 * back, right + 0.3 * back);
      world.AddWall(right + 0.3 * back, right);
      at = right;
    }
    world.AddWall(at, end);
  };
  wall({0, 0}, {30, 0}, {0, -1}, {4.0, 9.5, 17.0, 23.5});
  wall({30, 0}, {30, 20}, {1, 0}, {5.0, 13.0});
  wall({30, 20}, {0, 20}, {0, 1}, {6.5, 12.0, 22.0});
  wall({0, 20}, {0, 0}, {-1, 0}, {3.5, 8.0, 14.5});
  wall({2, 2}, {28, 2}, {0, 1}, {7.0, 19.0});
  wall({28, 2}, {28, 18}, {-1, 0}, {4.0, 11.5});
  wall({28, 18}, {2, 18}, {0, -1}, {3.0, 16.0});
  wall({2, 18}, {2, 2}, {1, 0}, {9.0});
  return world;
}

SimulatedLaserDrive SimulateLaserDrive(const LaserWorld& world, const LaserDriveModel& model,
                                       unsigned seed) {
  const Route route(model);
  SimulatedLaserDrive drive;
  drive.calibration.base_from_laser = model.base_from_laser;
  drive.calibration.laser_time_increment_s = model.time_increment_s;
  drive.start = route.At(0.0);
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0.0, model.range_noise_m);

  Pose2 odom_from_base = {3.0, -2.0, 0.7};
  Pose2 before = route.At(0.0);
  for (int i = 0; i / model.odometry_rate_hz <= route.duration_s() + 0.5; ++i) {
    const double time_s = i / model.odometry_rate_hz;
    const Pose2 now = route.At(time_s);
    Pose2 step = before.Inverse() * now;
    const double way_m = std::hypot(step.x_m, step.y_m);
    step.x_m *= 1.0 + model.odometry_scale;
    step.y_m *= 1.0 + model.odometry_scale;
    step.yaw_rad += model.odometry_turn_radpm * way_m;
    odom_from_base = odom_from_base * step;
    before = now;
    drive.frames.emplace_back(frames::Odometry{
        At(time_s), model.spoil ? model.spoil(time_s, odom_from_base) : odom_from_base});
  }
  const double increment_rad = model.field_of_view_rad / (model.beams - 1);
  for (int i = 0; i / model.scan_rate_hz <= route.duration_s(); ++i) {
    const double begin_s = i / model.scan_rate_hz;
    frames::LaserScan scan;
    scan.stamp_ns = At(begin_s + model.lag_s);
    scan.start_angle_rad = -0.5 * model.field_of_view_rad;
    scan.angle_increment_rad = increment_rad;
    for (int beam = 0; beam < model.beams; ++beam) {
      const double time_s = begin_s + beam * model.time_increment_s;
      const Eigen::Isometry3d map_from_laser =
          route.At(time_s).ToIsometry() * model.base_from_laser;
      const double angle = scan.start_angle_rad + beam * increment_rad;
      const Eigen::Vector3d direction =
          map_from_laser.linear() * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0.0);
      const Vector2d origin = map_from_laser.translation().head<2>();
      const double map_angle = std::atan2(direction.y(), direction.x());
      double range = world.Range(origin, map_angle);
      if (model.visitor) range = std::min(range, model.visitor(time_s, origin, map_angle));
      range += noise(random);
      scan.range_m.push_back(range <= model.max_range_m ? static_cast<float>(range)
                                                        : std::numeric_limits<float>::quiet_NaN());
    }
    const double middle_s = 0.5 * (model.beams - 1) * model.time_increment_s;
    drive.truth.push_back({At(begin_s + model.lag_s + middle_s), route.At(begin_s + middle_s)});
    drive.frames.emplace_back(std::move(scan));
  }
  std::stable_sort(drive.frames.begin(), drive.frames.end(),
                   [](const frames::Frame& a, const frames::Frame& b) {
                     return frames::StampOf(a) < frames::StampOf(b);
                   });
  return drive;
}

}  // namespace soundmap::mapping
