#pragma once

#include <Eigen/Geometry>
#include <random>
#include <vector>

// A room of 12 x 8 x 3 m with a corner at the origin of `map`, and a robot that drives round it.
namespace soundmap::benchmarks {

// To the wall, floor or ceiling, from a place inside.
double RangeInRoom_m(const Eigen::Vector3d& origin_in_map_m, const Eigen::Vector3d& direction);

// Place `step` of `steps` on an oval of 3 x 2 m radius; the sensors stand 0.9 m above the floor.
Eigen::Isometry3d MapFromSensor(int step, int steps);

// 40 rings of 750 points, in the sensor's frame, with 15 mm of noise.
std::vector<Eigen::Vector3f> LidarPoints(const Eigen::Isometry3d& map_from_sensor,
                                         std::mt19937_64& random);

}  // namespace soundmap::benchmarks
