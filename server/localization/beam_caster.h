#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "building/floor_plan.h"

namespace soundmap::localization {

// A laser beam in `map`, with its direction as a unit vector.
struct Ray {
  float x_m;
  float y_m;
  float direction_x;
  float direction_y;
};

enum class Ending : std::uint8_t {
  kWall,     // an occupied cell
  kUnknown,  // the map does not say what the beam meets from here on
};

struct Return {
  float range_m;  // to the near face of the cell where the beam ends
  Ending ending;
};

// Traces beams through a floor plan, cell by cell in effect: Cast() finds the same cell as an exact
// traversal, but crosses empty squares at one step. A beam passes free cells and ends at the first
// occupied one. Unknown is not a wall and not free: a patch of unknown cells in which no square of
// `unknown_gap_m` fits (gaps between the LIDAR's rings) is transparent; at a wider one, and at the
// edge of the plan, the beam ends as kUnknown. Memory: 5 bytes a cell. Immutable.
class BeamCaster {
 public:
  // InvalidArgument: a plan without an occupied cell, or with a side of 0 or more than 32 000
  // cells.
  static absl::StatusOr<BeamCaster> Create(const building::FloorPlan& plan, double unknown_gap_m);

  // `returns[i]` of `rays[i]`. A ray that begins outside the plan ends at once, as kUnknown.
  void Cast(std::span<const Ray> rays, std::span<Return> returns) const;

  // What ends a beam, in the plan's order with one more cell on every side.
  enum class Block : std::uint8_t { kNone, kWall, kUnknown };
  Block block(int column, int row) const {
    return blocks_[static_cast<std::size_t>(row + 1) * width_ + column + 1];
  }

 private:
  BeamCaster() = default;

  // With the border of one cell, which is unknown.
  int width_ = 0;
  int height_ = 0;
  float cells_per_m_ = 0.0f;
  float cell_size_m_ = 0.0f;
  Eigen::Vector2f corner_in_map_m_ = Eigen::Vector2f::Zero();
  std::vector<Block> blocks_;
  // By direction of travel (bit 0: towards smaller x, bit 1: towards smaller y), mirrored so that
  // travel is towards larger indices: the side of the largest empty square whose smallest corner is
  // the cell; 0 where a beam ends.
  std::vector<std::uint8_t> empty_side_cells_;
};

}  // namespace soundmap::localization
