#include "acoustics/direction_cells.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::acoustics {

DirectionCells::DirectionCells(const geometry::DirectionGrid& grid, double separation_rad) {
  const double near = std::cos(separation_rad);
  std::vector<Eigen::Vector3d> centre;
  for (int i = 0; i < grid.size(); ++i) {
    const bool taken = std::any_of(centre.begin(), centre.end(), [&](const Eigen::Vector3d& other) {
      return other.dot(grid[i]) > near;
    });
    if (taken) continue;
    centres_.push_back(i);
    centre.push_back(grid[i]);
    x_.push_back(static_cast<float>(grid[i].x()));
    y_.push_back(static_cast<float>(grid[i].y()));
    z_.push_back(static_cast<float>(grid[i].z()));
  }
  std::vector<int> cell_of(grid.size());
  begin_.assign(centres_.size() + 1, 0);
  for (int i = 0; i < grid.size(); ++i) {
    double nearest = -2.0;
    for (int cell = 0; cell < size(); ++cell) {
      const double dot = centre[cell].dot(grid[i]);
      if (dot <= nearest) continue;
      nearest = dot;
      cell_of[i] = cell;
    }
    reach_rad_ = std::max(reach_rad_, std::acos(std::clamp(nearest, -1.0, 1.0)));
    ++begin_[cell_of[i] + 1];
  }
  for (int cell = 0; cell < size(); ++cell) begin_[cell + 1] += begin_[cell];
  members_.resize(grid.size());
  std::vector<int> next(begin_.begin(), begin_.end() - 1);
  for (int i = 0; i < grid.size(); ++i) members_[next[cell_of[i]]++] = i;
}

std::vector<int> DirectionCells::CellsWithin(const Eigen::Vector3d& direction,
                                             double angle_rad) const {
  constexpr double kRounding = 1e-6;
  const auto near = static_cast<float>(std::cos(std::min(angle_rad, geometry::kPi)) - kRounding);
  const Eigen::Vector3f u = direction.cast<float>();
  std::vector<int> cells;
  for (int cell = 0; cell < size(); ++cell) {
    if (x_[cell] * u.x() + y_[cell] * u.y() + z_[cell] * u.z() >= near) cells.push_back(cell);
  }
  return cells;
}

}  // namespace soundmap::acoustics
