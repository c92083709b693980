#include "sources/simulation/free_floor.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>

namespace soundmap::simulation {
namespace {

constexpr double kCell_m = 0.1;
constexpr double kLineStep_m = 0.03;

double DistanceTo(const Box& box, const Eigen::Vector2d& point) {
  const Eigen::Array2d outside =
      (box.min_m.head<2>() - point).array().max((point - box.max_m.head<2>()).array()).max(0.0);
  return outside.matrix().norm();
}

}  // namespace

FreeFloor::FreeFloor(const Eigen::Vector3d& room_m, const std::vector<Box>& furniture,
                     double radius_m)
    : columns_(static_cast<int>(room_m.x() / kCell_m)),
      rows_(static_cast<int>(room_m.y() / kCell_m)),
      free_(static_cast<std::size_t>(columns_) * rows_) {
  for (int cell = 0; cell < columns_ * rows_; ++cell) {
    const Eigen::Vector2d point = CentreOf(cell);
    const double to_walls_m =
        point.array().min(room_m.head<2>().array() - point.array()).minCoeff();
    free_[cell] = to_walls_m >= radius_m &&
                  std::all_of(furniture.begin(), furniture.end(),
                              [&](const Box& box) { return DistanceTo(box, point) >= radius_m; });
  }
  KeepLargestPart();
}

int FreeFloor::CellOf(const Eigen::Vector2d& point_in_map) const {
  const int column = static_cast<int>(std::floor(point_in_map.x() / kCell_m));
  const int row = static_cast<int>(std::floor(point_in_map.y() / kCell_m));
  if (column < 0 || row < 0 || column >= columns_ || row >= rows_) return -1;
  return row * columns_ + column;
}

Eigen::Vector2d FreeFloor::CentreOf(int cell) const {
  return {(cell % columns_ + 0.5) * kCell_m, (cell / columns_ + 0.5) * kCell_m};
}

bool FreeFloor::IsFree(const Eigen::Vector2d& point_in_map) const {
  const int cell = CellOf(point_in_map);
  return cell >= 0 && free_[cell];
}

double FreeFloor::free_share() const {
  return static_cast<double>(std::count(free_.begin(), free_.end(), true)) /
         static_cast<double>(std::max<std::size_t>(1, free_.size()));
}

void FreeFloor::KeepLargestPart() {
  std::vector<int> part(free_.size(), -1);
  int largest = -1;
  std::size_t largest_size = 0;
  for (int seed = 0; seed < columns_ * rows_; ++seed) {
    if (!free_[seed] || part[seed] >= 0) continue;
    std::vector<int> cells = {seed};
    part[seed] = seed;
    for (std::size_t i = 0; i < cells.size(); ++i) {
      const int column = cells[i] % columns_, row = cells[i] / columns_;
      for (const auto& [c, r] : {std::pair(column - 1, row), std::pair(column + 1, row),
                                 std::pair(column, row - 1), std::pair(column, row + 1)}) {
        if (c < 0 || r < 0 || c >= columns_ || r >= rows_) continue;
        const int next = r * columns_ + c;
        if (!free_[next] || part[next] >= 0) continue;
        part[next] = seed;
        cells.push_back(next);
      }
    }
    if (cells.size() > largest_size) {
      largest = seed;
      largest_size = cells.size();
    }
  }
  for (std::size_t cell = 0; cell < free_.size(); ++cell) {
    free_[cell] = free_[cell] && part[cell] == largest;
  }
}

bool FreeFloor::IsLineFree(const Eigen::Vector2d& from, const Eigen::Vector2d& to) const {
  const int steps = static_cast<int>((to - from).norm() / kLineStep_m) + 1;
  for (int i = 0; i <= steps; ++i) {
    if (!IsFree(from + (to - from) * i / steps)) return false;
  }
  return true;
}

std::vector<Eigen::Vector2d> FreeFloor::ShortestPath(const Eigen::Vector2d& from,
                                                     const Eigen::Vector2d& to) const {
  if (!IsFree(from) || !IsFree(to)) return {};
  // Dijkstra from the goal over eight neighbours.
  const int start = CellOf(from), goal = CellOf(to);
  std::vector<double> cost(free_.size(), std::numeric_limits<double>::infinity());
  std::vector<int> next(free_.size(), -1);
  using Entry = std::pair<double, int>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  cost[goal] = 0.0;
  queue.emplace(0.0, goal);
  while (!queue.empty() && queue.top().second != start) {
    const auto [so_far, cell] = queue.top();
    queue.pop();
    if (so_far > cost[cell]) continue;
    for (int dr = -1; dr <= 1; ++dr) {
      for (int dc = -1; dc <= 1; ++dc) {
        const int column = cell % columns_ + dc, row = cell / columns_ + dr;
        if (column < 0 || row < 0 || column >= columns_ || row >= rows_) continue;
        const int neighbour = row * columns_ + column;
        const double here = so_far + std::hypot(dc, dr);
        if (!free_[neighbour] || here >= cost[neighbour]) continue;
        cost[neighbour] = here;
        next[neighbour] = cell;
        queue.emplace(here, neighbour);
      }
    }
  }
  // Pulled tight: each way point is the last one that is in sight.
  std::vector<Eigen::Vector2d> cells = {from};
  for (int cell = next[start]; cell >= 0 && cell != goal; cell = next[cell]) {
    cells.push_back(CentreOf(cell));
  }
  cells.push_back(to);
  std::vector<Eigen::Vector2d> path = {from};
  for (std::size_t i = 0; i + 1 < cells.size();) {
    std::size_t seen = i + 1;
    for (std::size_t k = cells.size() - 1; k > seen; --k) {
      if (IsLineFree(cells[i], cells[k])) seen = k;
    }
    path.push_back(cells[seen]);
    i = seen;
  }
  return path;
}

}  // namespace soundmap::simulation
