#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace soundmap::ray_casting {

// The points of one LIDAR scan by their direction as seen from one point, section V.
// The paper writes v_L(j) = M_j O_a / |M_j O_a|, an arrow from the point to the array, whose
// product with the direction v_a towards the source would be largest on the wrong side; here v_L(j)
// points from the array origin O_a to M_j.
class RangeIndex {
 public:
  // Points that are not finite, or lie at the origin, are never found. `max_angle_rad` above 0 and
  // below 60 degrees; epsilon = 1 - cos of it.
  RangeIndex(std::span<const Eigen::Vector3f> points, const Eigen::Vector3d& origin,
             double max_angle_rad);

  struct Hit {
    int point = 0;         // j_i, index into the points given
    double range_m = 0.0;  // rho_i, from the origin
  };

  // The point with the least 1 - v_L . v_a, of several the lowest index; none when that is not
  // below epsilon. `direction` is a unit vector on the axes of the points.
  std::optional<Hit> Nearest(const Eigen::Vector3d& direction) const;

 private:
  struct Entry {
    double x, y, z;  // v_L
    float range_m;
    std::int32_t point;
  };

  void Search(const Eigen::Vector3d& direction, double reach, double& best_dot,
              const Entry*& best) const;

  double epsilon_;
  double max_chord_;                 // between two unit vectors max_angle_rad apart
  std::vector<Entry> entries_;       // by cell
  std::vector<std::int32_t> begin_;  // of each cell in entries_, and the end
};

}  // namespace soundmap::ray_casting
