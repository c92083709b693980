#include "sound_map/floor_echo.h"

#include <algorithm>
#include <cmath>

namespace soundmap::sound_map {
namespace {

// A peak belongs to a place that lies so near its direction, along the plane.
constexpr double kNearPeak = 0.1;
// More scans err alike: a spectrum may have ripples of its own.
constexpr double kMostCounted = 100.0;
constexpr double kMaxScans = 1024.0;  // more are halved

// How much longer the way by the floor is.
double Detour_m(const Eigen::Vector3d& array_in_map_m, Eigen::Vector3d place_in_map_m) {
  const double straight_m = (place_in_map_m - array_in_map_m).norm();
  place_in_map_m.z() *= -1.0;
  return (place_in_map_m - array_in_map_m).norm() - straight_m;
}

// Of the peak that is heard in the direction of the place; null: none.
const frames::EchoRipple* RippleOf(const ArrayPlane& plane, const Eigen::Vector3d& place_in_map_m,
                                   std::span<const HeardPeak> peaks) {
  const auto along_plane = [&plane](const Eigen::Vector3d& in_map_m) -> Eigen::Vector3d {
    const Eigen::Vector3d direction = (in_map_m - plane.origin_in_map_m).normalized();
    return direction - direction.dot(plane.normal_in_map) * plane.normal_in_map;
  };
  const Eigen::Vector3d direction = along_plane(place_in_map_m);
  const frames::EchoRipple* nearest = nullptr;
  double nearest_off = kNearPeak;
  for (const HeardPeak& peak : peaks) {
    if (peak.ripple.values.empty()) continue;
    const double off = (along_plane(peak.place_in_map_m) - direction).norm();
    if (off >= nearest_off) continue;
    nearest = &peak.ripple;
    nearest_off = off;
  }
  return nearest;
}

void AddFits(const frames::EchoRipple& ripple, const Eigen::Vector3d& array_in_map_m,
             const Eigen::Vector3d& place_in_map_m, FloorEcho::Fits& fits) {
  for (int i = 0; i < FloorEcho::kHeights; ++i) {
    Eigen::Vector3d at = place_in_map_m;
    at.z() = std::max(at.z() + FloorEcho::kLowest_m + i * FloorEcho::kStep_m, 0.0);
    fits[i] += ripple.Fit(Detour_m(array_in_map_m, at));
  }
}

double Best(const FloorEcho::Fits& fits) { return *std::max_element(fits.begin(), fits.end()); }

// A fit has a standard deviation of 1, the difference of two of sqrt(2).
double InSigmas(double mean_difference, double scans) {
  return mean_difference * std::sqrt(0.5 * std::min(scans, kMostCounted));
}

}  // namespace

void FloorEcho::Add(const ArrayPlane& plane, const Eigen::Vector3d& place_in_map_m,
                    std::span<const HeardPeak> peaks) {
  const frames::EchoRipple* ripple = RippleOf(plane, place_in_map_m, peaks);
  if (ripple == nullptr) return;
  if (scans >= kMaxScans) {
    scans /= 2.0;
    for (double& fit : at_place) fit /= 2.0;
    for (double& fit : at_image) fit /= 2.0;
  }
  scans += 1.0;
  AddFits(*ripple, plane.origin_in_map_m, place_in_map_m, at_place);
  const double height_m = plane.normal_in_map.dot(place_in_map_m - plane.origin_in_map_m);
  image_in_map_m = place_in_map_m - 2.0 * height_m * plane.normal_in_map;
  AddFits(*ripple, plane.origin_in_map_m, image_in_map_m, at_image);
}

double FloorEcho::Against(const FloorEcho& other) const {
  const double least_scans = std::min(scans, other.scans);
  if (!(least_scans > 0.0)) return 0.0;
  return InSigmas(Best(at_place) / scans - Best(other.at_place) / other.scans, least_scans);
}

double FloorEcho::AtPlace() const {
  return scans > 0.0 ? Best(at_place) / scans * std::sqrt(std::min(scans, kMostCounted)) : 0.0;
}

double FloorEcho::AgainstImage() const {
  return scans > 0.0 ? InSigmas((Best(at_place) - Best(at_image)) / scans, scans) : 0.0;
}

Eigen::Vector3d FloorEcho::ImagePlace_in_map_m() const {
  const auto best = std::max_element(at_image.begin(), at_image.end());
  const double height_m = kLowest_m + static_cast<double>(best - at_image.begin()) * kStep_m;
  return {image_in_map_m.x(), image_in_map_m.y(), std::max(image_in_map_m.z() + height_m, 0.0)};
}

}  // namespace soundmap::sound_map
