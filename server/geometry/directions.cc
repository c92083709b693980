#include "geometry/directions.h"

#include <algorithm>
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
  constexpr int kSymmetry = 4;  // both mirror planes through the poles
  const int rings = std::max(1, static_cast<int>(std::lround(kPi / 2.0 / spacing_rad)));
  // Directions from the north pole to the lower edge of a ring's band, whose area is theirs.
  std::vector<int> up_to(rings + 1, 0);
  for (int r = 1; r <= rings; ++r) {
    const double area = 2.0 * kPi * (1.0 - std::cos(kPi / 2.0 * r / rings));
    up_to[r] =
        kSymmetry * static_cast<int>(std::lround(area / (spacing_rad * spacing_rad * kSymmetry)));
    up_to[r] = std::max(up_to[r], up_to[r - 1] + kSymmetry);
  }
  const auto edge_rad = [&](int r) {
    return std::asin(1.0 - static_cast<double>(up_to[r]) / up_to[rings]);
  };
  std::vector<Eigen::Vector3d> directions;
  directions.reserve(2 * up_to[rings]);
  for (int r = 0; r < 2 * rings; ++r) {
    const int north = std::min(r, 2 * rings - 1 - r);  // the same ring or its mirror image
    const double elevation_rad = 0.5 * (edge_rad(north) + edge_rad(north + 1));
    const int count = up_to[north + 1] - up_to[north];
    for (int i = 0; i < count; ++i) {
      directions.push_back(DirectionFromAngles(2.0 * kPi * (i + 0.5) / count,
                                               r == north ? elevation_rad : -elevation_rad));
    }
  }
  return DirectionGrid(std::move(directions), spacing_rad);
}

}  // namespace soundmap::geometry
