#pragma once

#include <Eigen/Core>
#include <vector>

namespace soundmap::geometry {

// Azimuth theta, counter-clockwise from x, and elevation phi, up from the x-y plane: section V's
// v_a(i).
Eigen::Vector3d DirectionFromAngles(double azimuth_rad, double elevation_rad);

struct DirectionAngles {
  double azimuth_rad = 0.0;
  double elevation_rad = 0.0;
};
DirectionAngles AnglesFromDirection(const Eigen::Vector3d& direction);

// Candidate directions: unit vectors, none twice.
class DirectionGrid {
 public:
  // The paper's grid: all pairs of azimuth and elevation, both limits included. A pole, where every
  // azimuth is one direction, stands once. The steps must be positive and the limits in order.
  static DirectionGrid Sector(double azimuth_min_rad, double azimuth_max_rad,
                              double elevation_min_rad, double elevation_max_rad, double step_rad);

  // Equal-area directions on the whole sphere, one per `spacing_rad` squared: 10 312 at 2 degrees.
  // They lie on rings about z, north to south. The grid is its own mirror image in the planes x-y,
  // x-z and y-z.
  static DirectionGrid EqualArea(double spacing_rad);

  explicit DirectionGrid(std::vector<Eigen::Vector3d> directions, double spacing_rad)
      : directions_(std::move(directions)), spacing_rad_(spacing_rad) {}

  int size() const { return static_cast<int>(directions_.size()); }
  const Eigen::Vector3d& operator[](int i) const { return directions_[i]; }
  auto begin() const { return directions_.begin(); }
  auto end() const { return directions_.end(); }
  // Nominal angle between neighbours.
  double spacing_rad() const { return spacing_rad_; }

 private:
  std::vector<Eigen::Vector3d> directions_;
  double spacing_rad_;
};

}  // namespace soundmap::geometry
