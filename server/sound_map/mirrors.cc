#include "sound_map/mirrors.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::sound_map {
namespace {

const double kMirrorCosine = std::cos(geometry::RadFromDeg(8.0));
constexpr double kMinScans = 16.0;
constexpr double kMaxScans = 1024.0;  // more are halved

}  // namespace

bool Mirrors::Has(std::uint64_t id, double share) const {
  const auto other = with.find(id);
  return other != with.end() && scans >= kMinScans && other->second >= share * scans;
}

void Mirrors::Merge(std::uint64_t from, std::uint64_t into) {
  const auto part = with.extract(from);
  if (part.empty()) return;
  double& whole = with[into];
  whole = std::max(whole, part.mapped());  // one scan may have heard both
}

void Mirrors::Swap(std::uint64_t a, std::uint64_t b) {
  auto of_a = with.extract(a);
  auto of_b = with.extract(b);
  if (of_a) with[b] = of_a.mapped();
  if (of_b) with[a] = of_b.mapped();
}

void CountMirrors(const std::optional<ArrayPlane>& plane, const std::vector<HeardPlace>& heard) {
  for (const HeardPlace& place : heard) {
    Mirrors& mirrors = *place.mirrors;
    if (mirrors.scans >= kMaxScans) {
      mirrors.scans /= 2.0;
      for (auto& [id, scans] : mirrors.with) scans /= 2.0;
    }
    mirrors.scans += 1.0;
  }
  if (!plane) return;
  std::vector<Eigen::Vector3d> directions;
  directions.reserve(heard.size());
  for (const HeardPlace& place : heard) {
    directions.push_back((place.place_in_map_m - plane->origin_in_map_m).normalized());
  }
  for (std::size_t a = 0; a < heard.size(); ++a) {
    const Eigen::Vector3d& direction = directions[a];
    const Eigen::Vector3d image =
        direction - 2.0 * plane->normal_in_map.dot(direction) * plane->normal_in_map;
    if (image.dot(direction) > kMirrorCosine) continue;
    for (std::size_t b = a + 1; b < heard.size(); ++b) {
      if (image.dot(directions[b]) < kMirrorCosine) continue;
      heard[a].mirrors->with[heard[b].id] += 1.0;
      heard[b].mirrors->with[heard[a].id] += 1.0;
    }
  }
}

}  // namespace soundmap::sound_map
