#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace soundmap::building {

// Cells of the largest floor plan, 410 m x 410 m at 0.05 m. Localization takes some 16 bytes for
// each, and two points far apart in a file must not take all memory.
inline constexpr std::int64_t kMaxFloorPlanCells = std::int64_t{1} << 26;

enum class Cell : std::uint8_t { kUnknown = 0, kFree = 1, kOccupied = 2 };

// The 2D map of section II-A: a horizontal slice of the building, flattened. Row-major, x fastest;
// the corner of cell (0, 0) with the smallest coordinates lies at `origin_in_map_m`. Axis-aligned
// with `map`. Unknown is not free.
class FloorPlan {
 public:
  FloorPlan() = default;
  FloorPlan(int width, int height, double cell_size_m, const Eigen::Vector2d& origin_in_map_m)
      : width_(width),
        height_(height),
        cell_size_m_(cell_size_m),
        origin_in_map_m_(origin_in_map_m),
        cells_(static_cast<std::size_t>(width) * height, Cell::kUnknown) {}

  int width() const { return width_; }
  int height() const { return height_; }
  double cell_size_m() const { return cell_size_m_; }
  const Eigen::Vector2d& origin_in_map_m() const { return origin_in_map_m_; }

  bool Contains(int column, int row) const {
    return column >= 0 && row >= 0 && column < width_ && row < height_;
  }
  Cell at(int column, int row) const {
    return cells_[static_cast<std::size_t>(row) * width_ + column];
  }
  Cell& at(int column, int row) { return cells_[static_cast<std::size_t>(row) * width_ + column]; }
  const std::vector<Cell>& cells() const { return cells_; }

  bool operator==(const FloorPlan&) const = default;

 private:
  int width_ = 0;
  int height_ = 0;
  double cell_size_m_ = 0.05;
  Eigen::Vector2d origin_in_map_m_ = Eigen::Vector2d::Zero();
  std::vector<Cell> cells_;
};

}  // namespace soundmap::building
