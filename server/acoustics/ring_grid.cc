#include "acoustics/ring_grid.h"

#include <cmath>

#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

using geometry::kPi;

constexpr double kSame = 1e-9;  // radians, and heights on the unit sphere

double AzimuthOf(const Eigen::Vector3d& direction) {
  return geometry::AnglesFromDirection(direction).azimuth_rad;
}

bool IsPole(double z) { return std::abs(z) > 1.0 - kSame; }

}  // namespace

std::optional<RingGrid> FindRings(const geometry::DirectionGrid& grid) {
  RingGrid found;
  std::optional<double> centre_rad;
  for (int first = 0; first < grid.size();) {
    Ring ring{grid[first].z(), first};
    while (first + ring.count < grid.size() &&
           std::abs(grid[first + ring.count].z() - ring.z) < kSame) {
      ++ring.count;
    }
    first += ring.count;
    if (ring.count > 1) {
      const double start_rad = AzimuthOf(grid[ring.first]);
      ring.step_rad = geometry::NormalizeAngle(AzimuthOf(grid[ring.first + 1]) - start_rad);
      for (int i = 1; i < ring.count; ++i) {
        const double off_rad = AzimuthOf(grid[ring.first + i]) - (start_rad + i * ring.step_rad);
        if (std::abs(geometry::NormalizeAngle(off_rad)) > kSame) return std::nullopt;
      }
    }
    if (!IsPole(ring.z)) {
      double middle_rad = AzimuthOf(grid[ring.first]) + 0.5 * (ring.count - 1) * ring.step_rad;
      const bool closed = std::abs(std::abs(ring.count * ring.step_rad) - 2.0 * kPi) < kSame;
      if (closed && ring.count % 4 == 0) {
        // Symmetric about every half step; the one half a step before the first direction.
        ring.circle = true;
        middle_rad = AzimuthOf(grid[ring.first]) - 0.5 * ring.step_rad;
      }
      middle_rad = geometry::NormalizeAngle(middle_rad);
      if (!centre_rad) centre_rad = middle_rad;
      if (std::abs(geometry::NormalizeAngle(middle_rad - *centre_rad)) > kSame) {
        return std::nullopt;
      }
    } else if (ring.count > 1) {
      return std::nullopt;
    }
    found.rings.push_back(ring);
  }
  found.centre_azimuth_rad = centre_rad.value_or(0.0);
  return found;
}

}  // namespace soundmap::acoustics
