#pragma once

#include <optional>
#include <vector>

#include "geometry/directions.h"

namespace soundmap::acoustics {

// Candidate directions of one height, evenly spaced and mirror images of each other about the
// azimuth `RingGrid::centre_azimuth_rad`.
struct Ring {
  double z = 0.0;
  int first = 0;  // in the grid; the azimuth grows, or falls, by `step_rad`
  int count = 0;
  double step_rad = 0.0;
  // A full circle, mirrored about the azimuth a quarter of it away as well.
  bool circle = false;

  // Azimuths off the centre from which the mirror images give all others: half of the directions,
  // or a quarter, from the smallest on.
  int base_count() const { return circle ? count / 4 : (count + 1) / 2; }
  double base_azimuth_rad(int i) const {
    return step_rad * (i + (circle || count % 2 == 0 ? 0.5 : 0.0));
  }
};

struct RingGrid {
  double centre_azimuth_rad = 0.0;
  std::vector<Ring> rings;  // in the order of the grid
};

// Empty: the grid is no such one.
std::optional<RingGrid> FindRings(const geometry::DirectionGrid& grid);

}  // namespace soundmap::acoustics
