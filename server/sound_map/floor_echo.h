#pragma once

#include <Eigen/Core>
#include <array>
#include <span>

#include "sound_map/registered_source.h"

namespace soundmap::sound_map {

// What the echo of the floor, z = 0 in the map, says of a place that arrays in a plane hear like
// its image above or below them: what comes from low down has its echo sooner. Old scans are
// forgotten.
struct FloorEcho {
  // An array in a plane hardly hears how high a place near the plane is: the echo is sought at
  // these heights about it.
  static constexpr double kLowest_m = -0.3;
  static constexpr double kStep_m = 0.05;
  static constexpr int kHeights = 13;
  using Fits = std::array<double, kHeights>;  // sums of EchoRipple::Fit() over the scans

  double scans = 0.0;  // that heard the place, with a ripple
  Fits at_place{};
  Fits at_image{};  // in the plane
  Eigen::Vector3d image_in_map_m = Eigen::Vector3d::Zero();

  // A scan that heard the place; `peaks` are the scan's.
  void Add(const ArrayPlane& plane, const Eigen::Vector3d& place_in_map_m,
           std::span<const HeardPeak> peaks);

  // In standard deviations of sound without an echo: how well the echo fits the place; 0: no scan.
  double AtPlace() const;
  // Likewise: the sound comes from this place (> 0) or from the other one (< 0).
  double Against(const FloorEcho& other) const;
  // From this place or from its image.
  double AgainstImage() const;
  // Above or below the image, where the echo fits best there.
  Eigen::Vector3d ImagePlace_in_map_m() const;

  bool operator==(const FloorEcho&) const = default;
};

}  // namespace soundmap::sound_map
