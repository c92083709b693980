#include "mapping/laser_search.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"
#include "mapping/laser_lines.h"

namespace soundmap::mapping {
namespace {

constexpr int kLevels = 6;
// A point counts for the less the further it is from the map's, as a bell of one cell.
constexpr int kBellReach = 2;
constexpr int kMaxCells = 1 << 26;
constexpr double kOtherPlace_m = 0.5;
constexpr double kOtherPlace_rad = 0.17;
constexpr double kAlmostAsGood = 0.9;

}  // namespace

LaserSearch::LaserSearch(std::span<const Eigen::Vector2f> point_in_map, double cell_m)
    : cell_m_(static_cast<float>(cell_m)), origin_(0, 0) {
  std::vector<Square> cells;
  Square low(0, 0), high(0, 0);
  for (const Eigen::Vector2f& point : point_in_map) {
    const auto cell = SquareOf(point, cell_m_);
    if (!cell) continue;
    low = cells.empty() ? *cell : low.cwiseMin(*cell);
    high = cells.empty() ? *cell : high.cwiseMax(*cell);
    cells.push_back(*cell);
  }
  const int margin = kBellReach + (1 << (kLevels - 1));
  const Eigen::Matrix<std::int64_t, 2, 1> size =
      (high - low).cast<std::int64_t>() +
      Eigen::Matrix<std::int64_t, 2, 1>::Constant(margin + kBellReach + 1);
  if (cells.empty() || size.x() * size.y() > kMaxCells) return;
  origin_ = low - Square::Constant(margin);
  width_ = static_cast<int>(size.x());
  height_ = static_cast<int>(size.y());
  levels_.resize(kLevels);
  levels_[0].assign(static_cast<std::size_t>(width_) * height_, 0);
  for (const Square& cell : cells) {
    for (int dy = -kBellReach; dy <= kBellReach; ++dy) {
      for (int dx = -kBellReach; dx <= kBellReach; ++dx) {
        const auto value =
            static_cast<std::uint8_t>(std::lround(255.0 * std::exp(-0.5 * (dx * dx + dy * dy))));
        const std::size_t at = static_cast<std::size_t>(cell.y() + dy - origin_.y()) * width_ +
                               static_cast<std::size_t>(cell.x() + dx - origin_.x());
        levels_[0][at] = std::max(levels_[0][at], value);
      }
    }
  }
  for (int level = 1; level < kLevels; ++level) {
    const int half = 1 << (level - 1);
    const std::vector<std::uint8_t>& fine = levels_[level - 1];
    std::vector<std::uint8_t>& coarse = levels_[level];
    coarse = fine;
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) {
        std::uint8_t& value = coarse[static_cast<std::size_t>(y) * width_ + x];
        const bool right = x + half < width_, up = y + half < height_;
        if (right) value = std::max(value, fine[static_cast<std::size_t>(y) * width_ + x + half]);
        if (!up) continue;
        const std::size_t above = static_cast<std::size_t>(y + half) * width_ + x;
        value = std::max(value, fine[above]);
        if (right) value = std::max(value, fine[above + half]);
      }
    }
  }
}

double LaserSearch::Score(const Rotation& rotation, int x, int y, int level) const {
  const std::vector<std::uint8_t>& grid = levels_[level];
  std::int64_t sum = 0;
  for (const Eigen::Vector2i& cell : rotation.cells) {
    const int column = cell.x() + x, row = cell.y() + y;
    if (column < 0 || row < 0 || column >= width_ || row >= height_) continue;
    sum += grid[static_cast<std::size_t>(row) * width_ + column];
  }
  return static_cast<double>(sum) / (255.0 * static_cast<double>(rotation.cells.size()));
}

// Depth first, best first; `best` gets what scores more. True if it has changed.
bool LaserSearch::Descend(const std::vector<Rotation>& rotations, std::vector<Candidate> candidates,
                          int level, int window_cells, std::span<const Candidate> excluded,
                          Candidate& best) const {
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  bool found = false;
  for (const Candidate& candidate : candidates) {
    if (candidate.score <= best.score) break;
    if (level == 0) {
      const auto is_near = [&](const Candidate& other) {
        return std::hypot(candidate.x - other.x, candidate.y - other.y) < kOtherPlace_m / cell_m_ &&
               std::abs(geometry::NormalizeAngle(rotations[candidate.rotation].yaw_rad -
                                                 rotations[other.rotation].yaw_rad)) <
                   kOtherPlace_rad;
      };
      if (std::any_of(excluded.begin(), excluded.end(), is_near)) continue;
      best = candidate;
      return true;  // the others score no more
    }
    const int half = 1 << (level - 1);
    std::vector<Candidate> parts;
    for (const int dy : {0, half}) {
      for (const int dx : {0, half}) {
        Candidate part{candidate.rotation, candidate.x + dx, candidate.y + dy, 0.0};
        if (part.x > window_cells || part.y > window_cells) continue;
        part.score = Score(rotations[part.rotation], part.x, part.y, level - 1);
        parts.push_back(part);
      }
    }
    found |= Descend(rotations, std::move(parts), level - 1, window_cells, excluded, best);
  }
  return found;
}

// Of the whole window at the level at which a few cells cover it; what scores no more than that is
// left out.
std::vector<LaserSearch::Candidate> LaserSearch::Coarsest(const std::vector<Rotation>& rotations,
                                                          int window_cells, double more_than,
                                                          int& level) const {
  level = 0;
  while (level + 1 < kLevels && (1 << level) < window_cells) ++level;
  std::vector<Candidate> candidates;
  for (int r = 0; r < static_cast<int>(rotations.size()); ++r) {
    for (int y = -window_cells; y <= window_cells; y += 1 << level) {
      for (int x = -window_cells; x <= window_cells; x += 1 << level) {
        const Candidate candidate{r, x, y, Score(rotations[r], x, y, level)};
        if (candidate.score > more_than) candidates.push_back(candidate);
      }
    }
  }
  return candidates;
}

std::vector<LaserSearch::Rotation> LaserSearch::Rotations(
    std::span<const Eigen::Vector2f> point_in_base, const geometry::Pose2& start_map_from_base,
    const LaserWindow& window) const {
  std::vector<Eigen::Vector2f> points;
  double furthest_m = 1.0;
  for (const Eigen::Vector2f& point : point_in_base) {
    const double distance_m = point.norm();
    if (!(distance_m <= window.max_point_distance_m)) continue;
    furthest_m = std::max(furthest_m, distance_m);
    points.push_back(point);
  }
  std::vector<Rotation> rotations;
  if (points.empty()) return rotations;
  // So fine that no point moves by more than a cell.
  const double step_rad = cell_m_ / furthest_m;
  const int steps = static_cast<int>(std::ceil(window.angle_rad / step_rad));
  for (int i = -steps; i <= steps; ++i) {
    Rotation rotation;
    rotation.yaw_rad = start_map_from_base.yaw_rad + i * step_rad;
    const float c = static_cast<float>(std::cos(rotation.yaw_rad));
    const float s = static_cast<float>(std::sin(rotation.yaw_rad));
    for (const Eigen::Vector2f& point : points) {
      const Eigen::Vector2f in_map(
          static_cast<float>(start_map_from_base.x_m) + c * point.x() - s * point.y(),
          static_cast<float>(start_map_from_base.y_m) + s * point.x() + c * point.y());
      if (const auto cell = SquareOf(in_map, cell_m_)) rotation.cells.push_back(*cell - origin_);
    }
    if (rotation.cells.size() == points.size()) rotations.push_back(std::move(rotation));
  }
  return rotations;
}

std::vector<LaserSearchResult> LaserSearch::FindSeveral(
    std::span<const Eigen::Vector2f> point_in_base, const geometry::Pose2& start_map_from_base,
    const LaserWindow& window, double min_score, double min_share, int max_places) const {
  std::vector<LaserSearchResult> results;
  if (levels_.empty()) return results;
  const std::vector<Rotation> rotations = Rotations(point_in_base, start_map_from_base, window);
  const int window_cells = std::max(1, static_cast<int>(std::ceil(window.distance_m / cell_m_)));
  int level = 0;
  const std::vector<Candidate> coarsest =
      Coarsest(rotations, window_cells, min_share * min_score, level);
  std::vector<Candidate> found;
  while (static_cast<int>(found.size()) < max_places) {
    Candidate next;
    next.score = found.empty() ? min_score : min_share * found.front().score;
    if (!Descend(rotations, coarsest, level, window_cells, found, next)) break;
    found.push_back(next);
    results.push_back({{start_map_from_base.x_m + static_cast<double>(next.x) * cell_m_,
                        start_map_from_base.y_m + static_cast<double>(next.y) * cell_m_,
                        geometry::NormalizeAngle(rotations[next.rotation].yaw_rad)},
                       next.score,
                       false});
  }
  for (LaserSearchResult& result : results) result.unique = results.size() == 1;
  return results;
}

std::optional<LaserSearchResult> LaserSearch::Find(std::span<const Eigen::Vector2f> point_in_base,
                                                   const geometry::Pose2& start_map_from_base,
                                                   const LaserWindow& window,
                                                   double min_score) const {
  const std::vector<LaserSearchResult> found =
      FindSeveral(point_in_base, start_map_from_base, window, min_score, kAlmostAsGood, 2);
  if (found.empty()) return std::nullopt;
  return found.front();
}

}  // namespace soundmap::mapping
