#include "sources/simulation/scene.h"

#include <cmath>

namespace soundmap::simulation {

Scene MappingDrive(Scene scene) {
  constexpr std::uint64_t kOtherSeed = 0x9E3779B97F4A7C15u;
  constexpr std::int64_t kHourNs = 3'600'000'000'000;
  scene.has_audio = false;
  scene.seed ^= kOtherSeed;
  scene.path.laps = scene.path.mapping_laps;
  scene.start_time_ns -= kHourNs;
  return scene;
}

Eigen::Vector2d PersonPosition(const PersonConfig& person, double time_s) {
  const auto& points = person.way_points_m;
  const std::size_t segments = person.closed ? points.size() : points.size() - 1;
  double length_m = 0.0;
  for (std::size_t i = 0; i < segments; ++i) {
    length_m += (points[(i + 1) % points.size()] - points[i]).norm();
  }
  if (!(length_m > 0.0)) return points.front();
  double along_m = std::max(0.0, time_s) * person.speed_mps;
  if (person.closed) {
    along_m = std::fmod(along_m, length_m);
  } else {
    along_m = std::fmod(along_m, 2.0 * length_m);
    if (along_m > length_m) along_m = 2.0 * length_m - along_m;
  }
  for (std::size_t i = 0; i < segments; ++i) {
    const Eigen::Vector2d segment = points[(i + 1) % points.size()] - points[i];
    const double segment_m = segment.norm();
    if (along_m <= segment_m && segment_m > 0.0) return points[i] + segment * (along_m / segment_m);
    along_m -= segment_m;
  }
  return person.closed ? points.front() : points.back();
}

std::vector<Box> PeopleAt(const std::vector<PersonConfig>& people, double time_s) {
  std::vector<Box> boxes;
  for (const auto& person : people) {
    const Eigen::Vector2d position_m = PersonPosition(person, time_s);
    const Eigen::Vector3d half(person.size_m.x() / 2, person.size_m.y() / 2, 0.0);
    const Eigen::Vector3d feet(position_m.x(), position_m.y(), 0.0);
    boxes.push_back({feet - half, feet + half + Eigen::Vector3d(0, 0, person.size_m.z())});
  }
  return boxes;
}

}  // namespace soundmap::simulation
