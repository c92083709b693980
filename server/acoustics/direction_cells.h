#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "geometry/directions.h"

namespace soundmap::acoustics {

// A grid of directions in cells around some of them, its centres. The centres are evenly spread and
// so stand for the grid in statistics; every direction belongs to the nearest. Immutable.
class DirectionCells {
 public:
  // No two centres are nearer to each other than `separation_rad`, and no direction is farther than
  // that from its centre.
  DirectionCells(const geometry::DirectionGrid& grid, double separation_rad);

  int size() const { return static_cast<int>(centres_.size()); }
  // By cell: the index of its centre in the grid.
  std::span<const int> centres() const { return centres_; }
  // Members of the cells one after the other: indices in the grid.
  std::span<const int> members() const { return members_; }
  // The first member of the cell, or, of size(), the end.
  int begin(int cell) const { return begin_[cell]; }

  // Calls visit(i) for all directions of the grid within `angle_rad` of `direction`, and for some
  // more.
  template <typename Visit>
  void VisitAround(const Eigen::Vector3d& direction, double angle_rad, Visit visit) const {
    for (const int cell : CellsWithin(direction, angle_rad + reach_rad_)) {
      for (int m = begin_[cell]; m < begin_[cell + 1]; ++m) visit(members_[m]);
    }
  }

 private:
  std::vector<int> CellsWithin(const Eigen::Vector3d& direction, double angle_rad) const;

  std::vector<int> centres_;
  std::vector<int> members_;
  std::vector<int> begin_;
  std::vector<float> x_, y_, z_;  // of the centres
  double reach_rad_ = 0.0;        // from a centre to its farthest member
};

}  // namespace soundmap::acoustics
