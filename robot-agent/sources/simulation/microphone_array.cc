#include "sources/simulation/microphone_array.h"

#include <cmath>
#include <numbers>

namespace soundmap::simulation {
namespace {

constexpr double kPi = std::numbers::pi;

void AddRing(std::vector<Eigen::Vector3d>& positions, int count, double radius_m, double z_m,
             double first_azimuth_rad) {
  for (int i = 0; i < count; ++i) {
    const double azimuth_rad = first_azimuth_rad + 2.0 * kPi * i / count;
    positions.emplace_back(radius_m * std::cos(azimuth_rad), radius_m * std::sin(azimuth_rad), z_m);
  }
}

}  // namespace

std::optional<ArrayShape> ArrayShapeFromName(std::string_view name) {
  if (name == "ring") return ArrayShape::kRing;
  if (name == "two_rings") return ArrayShape::kTwoRings;
  if (name == "dome") return ArrayShape::kDome;
  if (name == "sphere") return ArrayShape::kSphere;
  if (name == "cube") return ArrayShape::kCube;
  return std::nullopt;
}

std::vector<Eigen::Vector3d> MakeArray(ArrayShape shape, int count, double radius_m,
                                       double height_m) {
  std::vector<Eigen::Vector3d> positions;
  switch (shape) {
    case ArrayShape::kRing:
      AddRing(positions, count, radius_m, 0.0, 0.0);
      break;
    case ArrayShape::kTwoRings: {
      const int lower = (count + 1) / 2;
      AddRing(positions, lower, radius_m, 0.0, 0.0);
      AddRing(positions, count - lower, radius_m, height_m, kPi / lower);
      break;
    }
    case ArrayShape::kDome: {
      constexpr int kCounts[] = {8, 5, 3};
      constexpr double kElevations[] = {0.0, 35.0, 70.0};
      for (int ring = 0; ring < 3; ++ring) {
        const double elevation_rad = kElevations[ring] * kPi / 180.0;
        AddRing(positions, kCounts[ring], radius_m * std::cos(elevation_rad),
                radius_m * std::sin(elevation_rad), ring == 0 ? 0.0 : kPi / (kCounts[ring] * ring));
      }
      break;
    }
    case ArrayShape::kSphere: {
      const double golden_angle_rad = kPi * (3.0 - std::sqrt(5.0));
      for (int i = 0; i < count; ++i) {
        const double z = 1.0 - (2.0 * i + 1.0) / count;
        const double r = std::sqrt(1.0 - z * z);
        positions.emplace_back(radius_m * r * std::cos(golden_angle_rad * i),
                               radius_m * r * std::sin(golden_angle_rad * i), radius_m * z);
      }
      break;
    }
    case ArrayShape::kCube: {
      const double half_edge_m = radius_m / std::sqrt(3.0);
      for (int corner = 0; corner < 8; ++corner) {
        positions.emplace_back((corner & 1) ? half_edge_m : -half_edge_m,
                               (corner & 2) ? half_edge_m : -half_edge_m,
                               (corner & 4) ? half_edge_m : -half_edge_m);
      }
      break;
    }
  }
  return positions;
}

}  // namespace soundmap::simulation
