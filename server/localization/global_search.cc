#include "localization/global_search.h"

#include <algorithm>
#include <cmath>
#include <queue>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

constexpr int kCoarsestLevel = 6;
constexpr double kMaxCells = 4e6;
constexpr double kFull = 255.0;

// Poses in a sector that are looked at as the same place.
bool SamePlace(const geometry::Pose2& a, const geometry::Pose2& b, const SearchConfig& config) {
  return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m) < config.apart_m &&
         std::abs(geometry::NormalizeAngle(a.yaw_rad - b.yaw_rad)) < config.apart_rad;
}

}  // namespace

struct GlobalSearch::Node {
  std::uint32_t bound;
  std::int32_t yaw;  // index in the sector
  std::int32_t x, y;
  std::int32_t level;

  // The queue's order; the last terms make it the same on every run.
  bool operator<(const Node& other) const {
    if (bound != other.bound) return bound < other.bound;
    if (level != other.level) return level > other.level;
    if (yaw != other.yaw) return yaw > other.yaw;
    if (y != other.y) return y > other.y;
    return x > other.x;
  }
};

GlobalSearch::GlobalSearch(const SearchConfig& config, const building::FloorPlan& plan)
    : config_(config), corner_in_map_m_(plan.origin_in_map_m()) {
  const double plan_width_m = plan.width() * plan.cell_size_m();
  const double plan_height_m = plan.height() * plan.cell_size_m();
  cell_size_m_ = std::max({config.cell_m, plan.cell_size_m(),
                           std::sqrt((plan_width_m + 2.0 * config.max_range_m) *
                                     (plan_height_m + 2.0 * config.max_range_m) / kMaxCells)});
  field_std_m_ = std::max(config.field_std_m, cell_size_m_);
  width_ = static_cast<int>(std::ceil(plan_width_m / cell_size_m_));
  height_ = static_cast<int>(std::ceil(plan_height_m / cell_size_m_));
  margin_cells_ = static_cast<int>(std::ceil(config.max_range_m / cell_size_m_)) + 2;
  stride_ = width_ + 2 * margin_cells_;
  const int rows = height_ + 2 * margin_cells_;
  const std::size_t cells = static_cast<std::size_t>(stride_) * rows;

  // The field, by spreading each wall cell over its neighbourhood.
  levels_.resize(kCoarsestLevel + 1);
  Level& finest = levels_.front();
  finest.largest.assign(cells, 0);
  finest.blocks_across = width_;
  finest.any_free.assign(static_cast<std::size_t>(width_) * height_, false);
  const int reach_cells = static_cast<int>(std::ceil(2.5 * field_std_m_ / cell_size_m_));
  const int side = 2 * reach_cells + 1;
  std::vector<std::uint8_t> bell(static_cast<std::size_t>(side) * side);
  for (int v = -reach_cells; v <= reach_cells; ++v) {
    for (int u = -reach_cells; u <= reach_cells; ++u) {
      const double distances = std::hypot(u, v) * cell_size_m_ / field_std_m_;
      bell[static_cast<std::size_t>(v + reach_cells) * side + u + reach_cells] =
          static_cast<std::uint8_t>(std::lround(kFull * std::exp(-0.5 * distances * distances)));
    }
  }
  std::vector<bool> wall(cells, false);
  for (int row = 0; row < plan.height(); ++row) {
    const int y = static_cast<int>((row + 0.5) * plan.cell_size_m() / cell_size_m_);
    for (int column = 0; column < plan.width(); ++column) {
      const int x = static_cast<int>((column + 0.5) * plan.cell_size_m() / cell_size_m_);
      switch (plan.at(column, row)) {
        case building::Cell::kOccupied:
          wall[static_cast<std::size_t>(y + margin_cells_) * stride_ + x + margin_cells_] = true;
          break;
        case building::Cell::kFree:
          finest.any_free[static_cast<std::size_t>(y) * width_ + x] = true;
          has_free_cell_ = true;
          break;
        case building::Cell::kUnknown:
          break;
      }
    }
  }
  for (int y = reach_cells; y < rows - reach_cells; ++y) {
    for (int x = reach_cells; x < stride_ - reach_cells; ++x) {
      if (!wall[static_cast<std::size_t>(y) * stride_ + x]) continue;
      for (int v = -reach_cells; v <= reach_cells; ++v) {
        std::uint8_t* field =
            &finest.largest[static_cast<std::size_t>(y + v) * stride_ + x - reach_cells];
        const std::uint8_t* value = &bell[static_cast<std::size_t>(v + reach_cells) * side];
        for (int i = 0; i < side; ++i) field[i] = std::max(field[i], value[i]);
      }
    }
  }

  for (int l = 1; l <= kCoarsestLevel; ++l) {
    const Level& finer = levels_[l - 1];
    Level& level = levels_[l];
    const int half = 1 << (l - 1);
    level.largest.resize(cells);
    for (int y = 0; y < rows; ++y) {
      const int above = std::min(y + half, rows - 1);
      for (int x = 0; x < stride_; ++x) {
        const int right = std::min(x + half, stride_ - 1);
        const auto at = [&](int column, int row) {
          return finer.largest[static_cast<std::size_t>(row) * stride_ + column];
        };
        level.largest[static_cast<std::size_t>(y) * stride_ + x] =
            std::max({at(x, y), at(right, y), at(x, above), at(right, above)});
      }
    }
    const int finer_down = static_cast<int>(finer.any_free.size()) / finer.blocks_across;
    level.blocks_across = (finer.blocks_across + 1) / 2;
    const int down = (finer_down + 1) / 2;
    level.any_free.assign(static_cast<std::size_t>(level.blocks_across) * down, false);
    for (int y = 0; y < finer_down; ++y) {
      for (int x = 0; x < finer.blocks_across; ++x) {
        if (finer.any_free[static_cast<std::size_t>(y) * finer.blocks_across + x]) {
          level.any_free[static_cast<std::size_t>(y / 2) * level.blocks_across + x / 2] = true;
        }
      }
    }
  }
}

std::uint32_t GlobalSearch::Sum(const Level& level, std::span<const std::int32_t> offsets, int x,
                                int y) const {
  const std::uint8_t* origin = level.largest.data() + static_cast<std::ptrdiff_t>(y) * stride_ + x;
  std::uint32_t sum = 0;
  for (const std::int32_t offset : offsets) sum += origin[offset];
  return sum;
}

std::vector<Candidate> GlobalSearch::Search(std::span<const Eigen::Vector2d> points_in_base,
                                            int sector) const {
  std::vector<Eigen::Vector2d> points;
  for (const Eigen::Vector2d& point : points_in_base) {
    if (point.norm() <= config_.max_range_m) points.push_back(point);
  }
  if (points.empty() || !has_free_cell_) return {};

  const double sector_rad = 2.0 * geometry::kPi / config_.sectors;
  const int yaws = std::max(1, static_cast<int>(std::ceil(sector_rad / config_.yaw_step_rad)));
  const auto yaw_of = [&](int yaw) {
    return geometry::NormalizeAngle(sector * sector_rad + (yaw + 0.5) * sector_rad / yaws);
  };
  // A point's cell relative to that of base_link, which stands in the middle of its own.
  std::vector<std::int32_t> offsets(points.size() * yaws);
  for (int yaw = 0; yaw < yaws; ++yaw) {
    const double c = std::cos(yaw_of(yaw));
    const double s = std::sin(yaw_of(yaw));
    for (std::size_t i = 0; i < points.size(); ++i) {
      const auto u = static_cast<std::int32_t>(
          std::lround((c * points[i].x() - s * points[i].y()) / cell_size_m_));
      const auto v = static_cast<std::int32_t>(
          std::lround((s * points[i].x() + c * points[i].y()) / cell_size_m_));
      offsets[yaw * points.size() + i] = (v + margin_cells_) * stride_ + u + margin_cells_;
    }
  }

  int evaluations = 0;
  std::priority_queue<Node> open;
  const auto min_sum =
      static_cast<std::uint32_t>(config_.min_score * kFull * static_cast<double>(points.size()));
  const auto add = [&](int l, int yaw, int x, int y) {
    const Level& level = levels_[l];
    if (x >= width_ || y >= height_ ||
        !level.any_free[static_cast<std::size_t>(y >> l) * level.blocks_across + (x >> l)]) {
      return;
    }
    ++evaluations;
    const std::span<const std::int32_t> of_yaw(offsets.data() + yaw * points.size(), points.size());
    const std::uint32_t bound = Sum(level, of_yaw, x, y);
    if (bound >= min_sum) open.push({bound, yaw, x, y, l});
  };
  const auto pose_of = [&](const Node& node) {
    return geometry::Pose2{corner_in_map_m_.x() + (node.x + 0.5) * cell_size_m_,
                           corner_in_map_m_.y() + (node.y + 0.5) * cell_size_m_, yaw_of(node.yaw)};
  };

  constexpr int kBlock = 1 << kCoarsestLevel;
  for (int yaw = 0; yaw < yaws; ++yaw) {
    for (int y = 0; y < height_; y += kBlock) {
      for (int x = 0; x < width_; x += kBlock) add(kCoarsestLevel, yaw, x, y);
    }
  }
  std::vector<Candidate> found;
  while (!open.empty() && static_cast<int>(found.size()) < config_.max_candidates &&
         evaluations < config_.max_evaluations) {
    const Node node = open.top();
    open.pop();
    if (node.level > 0) {
      const int half = 1 << (node.level - 1);
      for (int i = 0; i < 4; ++i) {
        add(node.level - 1, node.yaw, node.x + (i & 1) * half, node.y + (i >> 1) * half);
      }
      continue;
    }
    const geometry::Pose2 pose = pose_of(node);
    const bool known = std::any_of(found.begin(), found.end(), [&](const Candidate& better) {
      return SamePlace(better.map_from_base, pose, config_);
    });
    if (!known) {
      found.push_back({pose, node.bound / (kFull * static_cast<double>(points.size()))});
    }
  }
  return found;
}

}  // namespace soundmap::localization
