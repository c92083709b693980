#include "geometry/directions.h"

#include <cmath>

#include "geometry/angles.h"

namespace soundmap::geometry {

Eigen::Vector3d DirectionFromAngles(double azimuth_rad, double elevation_rad) {
  return {std::cos(azimuth_rad) * std::cos(elevation_rad),
          std::sin(azimuth_rad) * std::cos(elevation_rad), std::sin(elevation_rad)};
}

DirectionAngles AnglesFromDirection(const Eigen::Vector3d& direction) {
  return {std::atan2(direction.y(), direction.x()),
          std::atan2(direction.z(), std::hypot(direction.x(), direction.y()))};
}

DirectionGrid DirectionGrid::Sector(double azimuth_min_rad, double azimuth_max_rad,
                                    double elevation_min_rad, double elevation_max_rad,
                                    double step_rad) {
  const auto steps = [step_rad](double min_rad, double max_rad) {
    return static_cast<int>(std::floor((max_rad - min_rad) / step_rad + 1e-6)) + 1;
  };
  const int elevations = steps(elevation_min_rad, elevation_max_rad);
  int azimuths = steps(azimuth_min_rad, azimuth_max_rad);
  // A full circle closes on itself.
  if (azimuth_min_rad + (azimuths - 1) * step_rad > azimuth_min_rad + 2.0 * kPi - 0.5 * step_rad) {
    --azimuths;
  }
  std::vector<Eigen::Vector3d> directions;
  directions.reserve(static_cast<std::size_t>(azimuths) * elevations);
  for (int e = 0; e < elevations; ++e) {
    const double elevation_rad = elevation_min_rad + e * step_rad;
    const bool pole = std::abs(elevation_rad) > kPi / 2.0 - 1e-9;
    for (int a = 0; a < (pole ? 1 : azimuths); ++a) {
      directions.push_back(DirectionFromAngles(azimuth_min_rad + a * step_rad, elevation_rad));
    }
  }
  return DirectionGrid(std::move(directions), step_rad);
}

DirectionGrid DirectionGrid::EqualArea(double spacing_rad) {
  const int count = static_cast<int>(std::lround(4.0 * kPi / (spacing_rad * spacing_rad)));
  const double golden_angle_rad = kPi * (3.0 - std::sqrt(5.0));
  std::vector<Eigen::Vector3d> directions;
  directions.reserve(count);
  for (int i = 0; i < count; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / count;
    const double radius = std::sqrt(1.0 - z * z);
    const double azimuth_rad = std::fmod(i * golden_angle_rad, 2.0 * kPi);
    directions.emplace_back(radius * std::cos(azimuth_rad), radius * std::sin(azimuth_rad), z);
  }
  return DirectionGrid(std::move(directions), spacing_rad);
}

}  // namespace soundmap::geometry
