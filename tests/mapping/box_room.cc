#include "tests/mapping/box_room.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "geometry/angles.h"

namespace soundmap::mapping {
namespace {

using geometry::kPi;
using geometry::Pose2;

double BoxDistance(const Box& box, const Eigen::Vector3d& point) {
  const Eigen::Vector3d outside = (box.min - point).cwiseMax(point - box.max);
  return outside.cwiseMax(0.0).norm() + std::min(outside.maxCoeff(), 0.0);
}

Eigen::Vector3d BeamDirection(const DriveModel& model, int ring, double azimuth_rad) {
  const double elevation_rad = geometry::RadFromDeg(-35.0 + 70.0 * ring / (model.rings - 1));
  return {std::cos(elevation_rad) * std::cos(azimuth_rad),
          std::cos(elevation_rad) * std::sin(azimuth_rad), std::sin(elevation_rad)};
}

Eigen::Vector3f Beam(const World& world, const DriveModel& model, const Pose2& map_from_base,
                     int ring, int column, std::mt19937& random,
                     std::optional<double> time_s = std::nullopt) {
  std::normal_distribution<double> noise(0.0, 1.0);
  const Eigen::Vector3d direction = BeamDirection(model, ring, 2 * kPi * column / model.columns);
  const Eigen::Isometry3d map_from_lidar = map_from_base.ToIsometry() * model.base_from_lidar;
  const Eigen::Vector3d in_map = map_from_lidar.linear() * direction;
  double range_m = world(map_from_lidar.translation(), in_map);
  if (time_s && model.moving) {
    range_m = std::min(range_m, model.moving(*time_s, map_from_lidar.translation(), in_map));
  }
  if (model.range_noise_m > 0.0) range_m += model.range_noise_m * noise(random);
  return (range_m * direction).cast<float>();
}

}  // namespace

BoxRoom BoxRoom::WithFurniture() {
  return BoxRoom({8.0, 6.0, 2.5}, {{{3.0, 2.4, 0.0}, {5.0, 3.6, 0.8}},
                                   {{0.0, 0.0, 0.0}, {0.6, 2.0, 1.8}},
                                   {{6.5, 5.2, 0.0}, {8.0, 6.0, 1.1}}});
}

double BoxRoom::operator()(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
  double nearest = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    if (direction[axis] == 0.0) continue;
    const double wall = direction[axis] > 0.0 ? room_.max[axis] : room_.min[axis];
    nearest = std::min(nearest, (wall - origin[axis]) / direction[axis]);
  }
  for (const Box& box : obstacles_) {
    double enter = 0.0;
    double leave = std::numeric_limits<double>::infinity();
    for (int axis = 0; axis < 3; ++axis) {
      if (direction[axis] == 0.0) {
        if (origin[axis] < box.min[axis] || origin[axis] > box.max[axis]) leave = -1.0;
        continue;
      }
      const double a = (box.min[axis] - origin[axis]) / direction[axis];
      const double b = (box.max[axis] - origin[axis]) / direction[axis];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    if (enter < leave) nearest = std::min(nearest, enter);
  }
  return nearest;
}

double BoxRoom::SignedDistance(const Eigen::Vector3d& point) const {
  double distance = -BoxDistance(room_, point);
  for (const Box& box : obstacles_) distance = std::min(distance, BoxDistance(box, point));
  return distance;
}

BoxRoom RingCorridor(double length_m, double depth_m, double width_m) {
  constexpr double kHeight_m = 2.6;
  constexpr double kPost_m = 0.15;  // of a door frame, out of the wall
  std::vector<Box> boxes = {
      {{width_m, width_m, 0.0}, {length_m - width_m, depth_m - width_m, kHeight_m}}};
  for (double at_m = 4.0; at_m < length_m - 4.0; at_m += 4.0) {
    for (const double y_m : {0.0, width_m - kPost_m, depth_m - width_m, depth_m - kPost_m}) {
      boxes.push_back({{at_m, y_m, 0.0}, {at_m + 0.2, y_m + kPost_m, 2.1}});
      boxes.push_back({{at_m + 1.1, y_m, 0.0}, {at_m + 1.3, y_m + kPost_m, 2.1}});
    }
  }
  for (double at_m = 4.0; at_m < depth_m - 4.0; at_m += 4.0) {
    for (const double x_m : {0.0, width_m - kPost_m, length_m - width_m, length_m - kPost_m}) {
      boxes.push_back({{x_m, at_m, 0.0}, {x_m + kPost_m, at_m + 0.2, 2.1}});
      boxes.push_back({{x_m, at_m + 1.1, 0.0}, {x_m + kPost_m, at_m + 1.3, 2.1}});
    }
  }
  boxes.push_back({{0.45 * length_m, 0.0, 0.0}, {0.45 * length_m + 0.5, 0.4, 1.0}});
  boxes.push_back({{length_m - 0.4, 0.6 * depth_m, 0.0}, {length_m, 0.6 * depth_m + 1.0, 1.9}});
  boxes.push_back({{0.2 * length_m, depth_m - 0.5, 0.0}, {0.2 * length_m + 0.8, depth_m, 0.8}});
  return BoxRoom({length_m, depth_m, kHeight_m}, std::move(boxes));
}

Pose2 AlongRing(double length_m, double depth_m, double width_m, double way_m) {
  const double radius_m = 0.8;
  const double arc_m = radius_m * kPi / 2;
  const double sides[] = {length_m - width_m - 2 * radius_m, depth_m - width_m - 2 * radius_m};
  const double lap_m = 2 * (sides[0] + sides[1] + 2 * arc_m);
  double left_m = std::fmod(way_m + 0.5 * sides[0], lap_m);
  Pose2 pose{0.5 * width_m + radius_m, 0.5 * width_m, 0.0};
  for (int side = 0;; ++side) {
    const double straight_m = sides[side % 2];
    if (left_m < straight_m) return pose * Pose2{left_m, 0.0, 0.0};
    left_m -= straight_m;
    pose = pose * Pose2{straight_m, 0.0, 0.0};
    const double turn_rad = std::min(left_m, arc_m) / radius_m;
    const Pose2 turned = pose * Pose2{radius_m * std::sin(turn_rad),
                                      radius_m * (1.0 - std::cos(turn_rad)), turn_rad};
    if (left_m < arc_m) return turned;
    left_m -= arc_m;
    pose = turned;
  }
}

Eigen::Vector2d Walker::At(double time_s) const {
  const double share = 0.5 - 0.5 * std::cos(2 * kPi * time_s / period_s);
  return from + share * (to - from);
}

double DistanceToWalker(const Walker& walker, double time_s, const Eigen::Vector3d& origin,
                        const Eigen::Vector3d& direction) {
  constexpr double kRadius_m = 0.25, kHeight_m = 1.8;
  const double infinite = std::numeric_limits<double>::infinity();
  const Eigen::Vector2d to_axis = walker.At(time_s) - origin.head<2>();
  const double flat = direction.head<2>().norm();
  if (flat < 1e-9) return infinite;
  const double along = to_axis.dot(direction.head<2>()) / flat;
  const double squared = to_axis.squaredNorm() - along * along;
  if (along <= 0.0 || squared >= kRadius_m * kRadius_m) return infinite;
  const double range = (along - std::sqrt(kRadius_m * kRadius_m - squared)) / flat;
  const double height = origin.z() + range * direction.z();
  return range > 0.0 && height > 0.0 && height < kHeight_m ? range : infinite;
}

Pose2 DriveModel::MapFromBase(double time_s) const {
  if (path) return path(time_s);
  // Counter-clockwise on an ellipse, looking ahead.
  const double phase = 2 * kPi * time_s / lap_s;
  return {centre.x() + radius.x() * std::cos(phase), centre.y() + radius.y() * std::sin(phase),
          std::atan2(radius.y() * std::cos(phase), -radius.x() * std::sin(phase))};
}

frames::Calibration DriveModel::Calibration() const {
  frames::Calibration calibration;
  calibration.base_from_lidar = base_from_lidar;
  calibration.base_from_laser = Eigen::Translation3d(0.2, 0.0, 0.3);
  return calibration;
}

namespace {

frames::LaserScan LaserScanAt(const World& world, const DriveModel& model, double time_s,
                              std::mt19937& random) {
  const Eigen::Isometry3d map_from_laser =
      model.MapFromBase(time_s).ToIsometry() * model.Calibration().base_from_laser;
  frames::LaserScan scan;
  scan.stamp_ns = kDriveStart_ns + std::llround((time_s + model.laser_stamp_late_s) * 1e9);
  scan.angle_increment_rad = 2 * kPi / model.laser_beams;
  std::bernoulli_distribution is_outlier(model.laser_outlier_share);
  for (int beam = 0; beam < model.laser_beams; ++beam) {
    const double angle_rad = beam * scan.angle_increment_rad;
    const Eigen::Vector3d direction =
        map_from_laser.linear() * Eigen::Vector3d(std::cos(angle_rad), std::sin(angle_rad), 0.0);
    const double range_m =
        is_outlier(random) ? 20.0 : world(map_from_laser.translation(), direction);
    scan.range_m.push_back(static_cast<float>(range_m));
  }
  return scan;
}

}  // namespace

std::vector<frames::Frame> SimulateDrive(const World& world, const DriveModel& model,
                                         unsigned seed) {
  std::mt19937 random(seed);
  std::vector<frames::Frame> drive;
  Pose2 odom_from_base;
  double next_lidar_s = 0.2;
  for (double time_s = 0.0; time_s <= model.duration_s; time_s += 0.05) {
    if (time_s > 0.0) {
      Pose2 step = model.MapFromBase(time_s - 0.05).Inverse() * model.MapFromBase(time_s);
      step.x_m *= model.odometry_scale;
      step.y_m *= model.odometry_scale;
      step.yaw_rad *= model.odometry_yaw_scale;
      odom_from_base = odom_from_base * step;
    }
    drive.emplace_back(
        frames::Odometry{kDriveStart_ns + std::llround(time_s * 1e9), odom_from_base});
    if (model.laser_beams > 0) drive.emplace_back(LaserScanAt(world, model, time_s, random));
    if (time_s < next_lidar_s || time_s + model.lidar_period_s > model.duration_s) continue;
    frames::LidarScan scan;
    scan.stamp_ns = kDriveStart_ns + std::llround(time_s * 1e9);
    for (int column = 0; column < model.columns; ++column) {
      const double offset_s = model.swept ? model.lidar_period_s * column / model.columns : 0.0;
      for (int ring = 0; ring < model.rings; ++ring) {
        const Eigen::Vector3f point = Beam(world, model, model.MapFromBase(time_s + offset_s), ring,
                                           column, random, time_s + offset_s);
        if (!point.allFinite()) continue;
        scan.point_in_lidar.push_back(point);
        if (model.swept) {
          scan.time_offset_ns.push_back(static_cast<std::uint32_t>(offset_s * 1e9));
        }
      }
    }
    drive.emplace_back(std::move(scan));
    next_lidar_s += model.lidar_period_s;
  }
  return drive;
}

std::vector<Eigen::Vector3f> ScanInBase(const World& world, const DriveModel& model,
                                        const Pose2& map_from_base, std::mt19937& random) {
  std::vector<Eigen::Vector3f> point_in_base;
  for (int column = 0; column < model.columns; ++column) {
    for (int ring = 0; ring < model.rings; ++ring) {
      point_in_base.push_back(model.base_from_lidar.cast<float>() *
                              Beam(world, model, map_from_base, ring, column, random));
    }
  }
  return point_in_base;
}

}  // namespace soundmap::mapping
