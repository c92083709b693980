#include "tests/benchmark/room.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/angles.h"
#include "geometry/directions.h"

namespace soundmap::benchmarks {

using geometry::kPi;

double RangeInRoom_m(const Eigen::Vector3d& origin_in_map_m, const Eigen::Vector3d& direction) {
  const Eigen::Vector3d size_m(12.0, 8.0, 3.0);
  double range_m = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    const double wall_m = direction[axis] > 0.0 ? size_m[axis] : 0.0;
    if (direction[axis] == 0.0) continue;
    range_m = std::min(range_m, (wall_m - origin_in_map_m[axis]) / direction[axis]);
  }
  return range_m;
}

Eigen::Isometry3d MapFromSensor(int step, int steps) {
  const double angle_rad = 2.0 * kPi * step / steps;
  Eigen::Isometry3d map_from_sensor = Eigen::Isometry3d::Identity();
  map_from_sensor.translation() =
      Eigen::Vector3d(6.0 + 3.0 * std::cos(angle_rad), 4.0 + 2.0 * std::sin(angle_rad), 0.9);
  map_from_sensor.linear() =
      Eigen::AngleAxisd(angle_rad + kPi / 2.0, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return map_from_sensor;
}

std::vector<Eigen::Vector3f> LidarPoints(const Eigen::Isometry3d& map_from_sensor,
                                         std::mt19937_64& random) {
  constexpr int kRings = 40;
  constexpr int kPerRing = 750;
  std::normal_distribution<double> noise_m(0.0, 0.015);
  std::vector<Eigen::Vector3f> point_in_sensor;
  for (int ring = 0; ring < kRings; ++ring) {
    for (int i = 0; i < kPerRing; ++i) {
      const Eigen::Vector3d direction =
          geometry::DirectionFromAngles(2.0 * kPi * i / kPerRing - kPi,
                                        geometry::RadFromDeg(-25.0 + 100.0 * ring / (kRings - 1)));
      const double range_m =
          RangeInRoom_m(map_from_sensor.translation(), map_from_sensor.linear() * direction) +
          noise_m(random);
      point_in_sensor.emplace_back((range_m * direction).cast<float>());
    }
  }
  return point_in_sensor;
}

}  // namespace soundmap::benchmarks
