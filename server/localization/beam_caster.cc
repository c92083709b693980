#include "localization/beam_caster.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace soundmap::localization {
namespace {

constexpr int kMaxSide_cells = 32000;

// Each step ends this far beyond the edge that it was computed for, so that rounding never leaves
// it before the edge.
constexpr float kBeyondEdge_cells = 1.0f / 256.0f;

// Two groups of four rays advance together: one group computes while the other waits for memory.
constexpr int kLanes = 4;
constexpr int kGroups = 2;
constexpr int kBatch = kLanes * kGroups;
using Floats = float __attribute__((vector_size(16)));
using Ints = std::int32_t __attribute__((vector_size(16)));

Floats Select(Ints mask, Floats yes, Floats no) {
  return reinterpret_cast<Floats>((mask & reinterpret_cast<Ints>(yes)) |
                                  (~mask & reinterpret_cast<Ints>(no)));
}

// Counts of marked cells in rectangles of a grid, after one pass over it.
class RectangleCounts {
 public:
  template <typename IsMarked>
  RectangleCounts(int width, int height, const IsMarked& is_marked)
      : width_(width), sums_(static_cast<std::size_t>(width + 1) * (height + 1), 0) {
    for (int y = 0; y < height; ++y) {
      std::int64_t row = 0;
      for (int x = 0; x < width; ++x) {
        row += is_marked(x, y) ? 1 : 0;
        sums_[Index(x + 1, y + 1)] = sums_[Index(x + 1, y)] + row;
      }
    }
  }

  // In [x, x + side) x [y, y + side), which must lie in the grid.
  std::int64_t Square(int x, int y, int side) const {
    return sums_[Index(x + side, y + side)] - sums_[Index(x, y + side)] -
           sums_[Index(x + side, y)] + sums_[Index(x, y)];
  }

 private:
  std::size_t Index(int x, int y) const { return static_cast<std::size_t>(y) * (width_ + 1) + x; }

  int width_;
  std::vector<std::int64_t> sums_;
};

// Cells of the plan that lie in a square of `side` unknown cells; outside the plan all is unknown.
std::vector<bool> WideUnknown(const building::FloorPlan& plan, int side) {
  const int margin = side - 1;
  const int width = plan.width() + 2 * margin;
  const int height = plan.height() + 2 * margin;
  const RectangleCounts unknown(width, height, [&](int x, int y) {
    return !plan.Contains(x - margin, y - margin) ||
           plan.at(x - margin, y - margin) == building::Cell::kUnknown;
  });
  const RectangleCounts squares(width - margin, height - margin, [&](int x, int y) {
    return unknown.Square(x, y, side) == static_cast<std::int64_t>(side) * side;
  });
  std::vector<bool> wide;
  wide.reserve(plan.cells().size());
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      wide.push_back(squares.Square(column, row, side) > 0);
    }
  }
  return wide;
}

}  // namespace

absl::StatusOr<BeamCaster> BeamCaster::Create(const building::FloorPlan& plan,
                                              double unknown_gap_m) {
  if (plan.width() < 1 || plan.height() < 1 || plan.width() > kMaxSide_cells ||
      plan.height() > kMaxSide_cells) {
    return absl::InvalidArgumentError(absl::StrCat("the floor plan has ", plan.width(), " x ",
                                                   plan.height(), " cells; a side has 1 to ",
                                                   kMaxSide_cells));
  }
  if (!(plan.cell_size_m() > 0.001 && plan.cell_size_m() < 10.0) ||
      !plan.origin_in_map_m().allFinite()) {
    return absl::InvalidArgumentError(
        "the floor plan's cell size is not between 0.001 and 10 m, or its origin is not finite");
  }
  BeamCaster caster;
  caster.width_ = plan.width() + 2;
  caster.height_ = plan.height() + 2;
  caster.cell_size_m_ = static_cast<float>(plan.cell_size_m());
  caster.cells_per_m_ = static_cast<float>(1.0 / plan.cell_size_m());
  caster.corner_in_map_m_ =
      (plan.origin_in_map_m() - Eigen::Vector2d::Constant(plan.cell_size_m())).cast<float>();

  const int width = caster.width_;
  const int height = caster.height_;
  const std::size_t cells = static_cast<std::size_t>(width) * height;
  const auto index = [width](int x, int y) { return static_cast<std::size_t>(y) * width + x; };
  const int gap_cells =
      std::max(1, static_cast<int>(std::lround(unknown_gap_m / plan.cell_size_m())));
  const std::vector<bool> wide = WideUnknown(plan, gap_cells);
  caster.blocks_.assign(cells, Block::kUnknown);
  bool any_wall = false;
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      Block& block = caster.blocks_[index(column + 1, row + 1)];
      if (plan.at(column, row) == building::Cell::kOccupied) {
        block = Block::kWall;
        any_wall = true;
      } else if (!wide[static_cast<std::size_t>(row) * plan.width() + column]) {
        block = Block::kNone;
      }
    }
  }
  if (!any_wall) return absl::InvalidArgumentError("the floor plan has no occupied cell");

  caster.empty_side_cells_.assign(4 * cells, 0);
  for (int quadrant = 0; quadrant < 4; ++quadrant) {
    std::uint8_t* side = caster.empty_side_cells_.data() + quadrant * cells;
    for (int y = height - 2; y >= 0; --y) {
      for (int x = width - 2; x >= 0; --x) {
        const int plan_x = quadrant & 1 ? width - 1 - x : x;
        const int plan_y = quadrant & 2 ? height - 1 - y : y;
        if (caster.blocks_[index(plan_x, plan_y)] != Block::kNone) continue;
        const int ahead =
            std::min({side[index(x + 1, y)], side[index(x, y + 1)], side[index(x + 1, y + 1)]});
        side[index(x, y)] = static_cast<std::uint8_t>(std::min(255, ahead + 1));
      }
    }
  }
  return caster;
}

void BeamCaster::Cast(std::span<const Ray> rays, std::span<Return> returns) const {
  const std::size_t cells = blocks_.size();
  const Floats zero = {};
  for (std::size_t first = 0; first < rays.size(); first += kBatch) {
    const int count = static_cast<int>(std::min<std::size_t>(kBatch, rays.size() - first));
    // In cells, mirrored so that the ray travels towards larger x and y.
    alignas(16) float x[kBatch], y[kBatch], dx[kBatch], dy[kBatch];
    const std::uint8_t* side[kBatch];
    bool mirrored_x[kBatch], mirrored_y[kBatch];
    for (int i = 0; i < kBatch; ++i) {
      const Ray& ray = rays[first + std::min(i, count - 1)];
      x[i] = (ray.x_m - corner_in_map_m_.x()) * cells_per_m_;
      y[i] = (ray.y_m - corner_in_map_m_.y()) * cells_per_m_;
      dx[i] = std::abs(ray.direction_x);
      dy[i] = std::abs(ray.direction_y);
      // The corner cell is blocked: a ray from outside, or with a number that is none, ends there.
      const bool inside = x[i] >= 0.0f && y[i] >= 0.0f && x[i] < static_cast<float>(width_) &&
                          y[i] < static_cast<float>(height_);
      if (!inside || !(dx[i] < 1.01f && dy[i] < 1.01f && dx[i] + dy[i] > 0.99f)) {
        x[i] = y[i] = 0.0f;
        dx[i] = dy[i] = 1.0f;
      }
      mirrored_x[i] = ray.direction_x < 0.0f;
      mirrored_y[i] = ray.direction_y < 0.0f;
      if (mirrored_x[i]) x[i] = static_cast<float>(width_) - x[i];
      if (mirrored_y[i]) y[i] = static_cast<float>(height_) - y[i];
      x[i] = std::min(x[i], static_cast<float>(width_) - 0.5f);
      y[i] = std::min(y[i], static_cast<float>(height_) - 0.5f);
      side[i] =
          empty_side_cells_.data() + cells * ((mirrored_x[i] ? 1 : 0) + (mirrored_y[i] ? 2 : 0));
    }
    Floats vx[kGroups], vy[kGroups], vdx[kGroups], vdy[kGroups], per_dx[kGroups], per_dy[kGroups],
        travelled[kGroups];
    Floats at_x[kGroups], at_y[kGroups];
    for (int g = 0; g < kGroups; ++g) {
      std::memcpy(&vx[g], x + g * kLanes, sizeof(Floats));
      std::memcpy(&vy[g], y + g * kLanes, sizeof(Floats));
      std::memcpy(&vdx[g], dx + g * kLanes, sizeof(Floats));
      std::memcpy(&vdy[g], dy + g * kLanes, sizeof(Floats));
      per_dx[g] = 1.0f / vdx[g];
      per_dy[g] = 1.0f / vdy[g];
      travelled[g] = zero;
      at_x[g] = vx[g];
      at_y[g] = vy[g];
    }
    Floats last_edge[kGroups] = {};
    Ints column[kGroups], row[kGroups];
    bool moving = true;
    while (moving) {
      Ints any = {};
      for (int g = 0; g < kGroups; ++g) {
        column[g] = __builtin_convertvector(at_x[g], Ints);
        row[g] = __builtin_convertvector(at_y[g], Ints);
        const Ints cell = row[g] * width_ + column[g];
        const Ints empty = {side[g * kLanes][cell[0]], side[g * kLanes + 1][cell[1]],
                            side[g * kLanes + 2][cell[2]], side[g * kLanes + 3][cell[3]]};
        const Ints open = empty > 0;
        any |= open;
        const Floats to_x =
            (__builtin_convertvector(column[g] + empty, Floats) - at_x[g]) * per_dx[g];
        const Floats to_y = (__builtin_convertvector(row[g] + empty, Floats) - at_y[g]) * per_dy[g];
        const Floats edge = travelled[g] + Select(to_x < to_y, to_x, to_y);
        last_edge[g] = Select(open, edge, last_edge[g]);
        travelled[g] = Select(open, edge + kBeyondEdge_cells, travelled[g]);
        at_x[g] = vx[g] + vdx[g] * travelled[g];
        at_y[g] = vy[g] + vdy[g] * travelled[g];
      }
      moving = (any[0] | any[1] | any[2] | any[3]) != 0;
    }
    for (int i = 0; i < count; ++i) {
      const int c = column[i / kLanes][i % kLanes];
      const int r = row[i / kLanes][i % kLanes];
      const int plan_x = mirrored_x[i] ? width_ - 1 - c : c;
      const int plan_y = mirrored_y[i] ? height_ - 1 - r : r;
      const Block block = blocks_[static_cast<std::size_t>(plan_y) * width_ + plan_x];
      returns[first + i] = {last_edge[i / kLanes][i % kLanes] * cell_size_m_,
                            block == Block::kWall ? Ending::kWall : Ending::kUnknown};
    }
  }
}

}  // namespace soundmap::localization
