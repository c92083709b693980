#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "sound_map/registered_source.h"

namespace soundmap::sound_map {

// An array whose microphones lie in a plane hears a place and its image in that plane alike. What
// is known of the images of one place. Old scans are forgotten.
struct Mirrors {
  double scans = 0.0;                    // that heard the place, with whatever array
  std::map<std::uint64_t, double> with;  // of these, that heard the other one, by id, as its image

  // Whether the place may be nothing but the image of the other one: in this share of the scans
  // that heard it, and these are not few, that one was heard where its image is.
  bool Has(std::uint64_t id, double share = 0.5) const;

  // `from` is part of `into` now.
  void Merge(std::uint64_t from, std::uint64_t into);
  // The two have exchanged their names.
  void Swap(std::uint64_t a, std::uint64_t b);
};

// A place that a scan heard.
struct HeardPlace {
  std::uint64_t id = 0;
  Eigen::Vector3d place_in_map_m = Eigen::Vector3d::Zero();
  Mirrors* mirrors = nullptr;
};

// Counts a scan that heard these places, each once. Directions are mirrored within 8 degrees;
// closer to the plane, above and below are one direction. Without a plane, that is, with an array
// in space, none are, and what the scan heard speaks against all images.
void CountMirrors(const std::optional<ArrayPlane>& plane, const std::vector<HeardPlace>& heard);

}  // namespace soundmap::sound_map
