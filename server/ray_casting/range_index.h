#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

namespace soundmap::ray_casting {

// The points of one LIDAR scan by their direction as seen from one point, section V.
// The paper writes v_L(j) = M_j O_a / |M_j O_a|, an arrow from the point to the array, whose
// product with the direction v_a towards the source would be largest on the wrong side; here v_L(j)
// points from the array origin O_a to M_j.
//
// Directions are compared in single precision first; what that cannot decide is decided in double
// precision, so that the answer is that of brute force in double precision.
class RangeIndex {
 public:
  // Points that are not finite, or lie at the origin, are never found. They must outlive the index.
  // `max_angle_rad` above 0 and below 60 degrees; epsilon = 1 - cos of it.
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
  struct Query;
  struct Range {
    std::int32_t begin;
    std::int32_t end;
  };

  // The least chord to `query` in the ranges, whose point it is (in the order of the cells), and
  // the least chord of the others; squared.
  struct Least {
    float chord2;
    std::int32_t at;
    float next_chord2;
  };

  void SortIntoCells();
  int RangesWithin(const Query& query, float angle_rad, Range* ranges) const;
  Least FindLeast(const Query& query, const Range* ranges, int count) const;
  int DecideInDouble(const Query& query, const Range* ranges, int count, float limit_chord2) const;
  double ExactDot(int point, const Eigen::Vector3d& direction) const;

  std::span<const Eigen::Vector3f> points_;
  Eigen::Vector3d origin_;
  double epsilon_;
  float max_chord_;  // between two unit vectors max_angle_rad apart
  float near_;       // a chord that most directions find a point within
  std::unique_ptr<float[]> storage_;
  const float* unit_[3];                   // v_L, by cell
  std::unique_ptr<std::int32_t[]> point_;  // index of each
  std::vector<std::int32_t> begin_;        // of each cell in them, and the end
};

}  // namespace soundmap::ray_casting
