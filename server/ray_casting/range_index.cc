#include "ray_casting/range_index.h"

#include <algorithm>
#include <cmath>

namespace soundmap::ray_casting {
namespace {

// A cubic grid around the unit sphere. Neighbouring directions lie in neighbouring cells, without
// poles or seams.
constexpr int kSide = 64;
constexpr double kCell = 2.0 / (kSide - 2);  // half a cell is left over on every side
constexpr double kFirst = -1.0 - kCell;

int CellOf(double coordinate) {
  return std::clamp(static_cast<int>((coordinate - kFirst) * (1.0 / kCell)), 0, kSide - 1);
}

// Only the cells that the sphere passes through can hold a direction. Before(c) counts those of a
// lower number (x fastest), so that cells in a row stay in a row and the table of entries stays
// small.
class SphereCells {
 public:
  SphereCells() : before_(kSide * kSide * kSide + 1, 0) {
    std::uint16_t count = 0;
    for (int c = 0; c < kSide * kSide * kSide; ++c) {
      before_[c] = count;
      double nearest2 = 0.0;
      double farthest2 = 0.0;
      for (const int part : {c % kSide, c / kSide % kSide, c / (kSide * kSide)}) {
        const double low = kFirst + part * kCell;
        const double high = low + kCell;
        const double near = low > 0.0 ? low : high < 0.0 ? high : 0.0;
        const double far = std::max(std::abs(low), std::abs(high));
        nearest2 += near * near;
        farthest2 += far * far;
      }
      constexpr double kRounding = 1e-9;
      if (nearest2 <= 1.0 + kRounding && farthest2 >= 1.0 - kRounding) ++count;
    }
    before_.back() = count;
  }

  int Before(int cell) const { return before_[cell]; }
  int count() const { return before_.back(); }

 private:
  std::vector<std::uint16_t> before_;
};

const SphereCells& Cells() {
  static const SphereCells cells;
  return cells;
}

int CellIndex(int x, int y, int z) { return (z * kSide + y) * kSide + x; }

}  // namespace

RangeIndex::RangeIndex(std::span<const Eigen::Vector3f> points, const Eigen::Vector3d& origin,
                       double max_angle_rad)
    : epsilon_(1.0 - std::cos(max_angle_rad)),
      // A little more, so that rounding cannot hide a point that passes the test with epsilon.
      max_chord_(2.0 * std::sin(0.5 * max_angle_rad) + 1e-9) {
  const SphereCells& cells = Cells();
  std::vector<Entry> unsorted;
  std::vector<std::uint16_t> cell_of;
  unsorted.reserve(points.size());
  cell_of.reserve(points.size());
  begin_.assign(cells.count() + 1, 0);
  for (std::size_t j = 0; j < points.size(); ++j) {
    const double x = points[j].x() - origin.x();
    const double y = points[j].y() - origin.y();
    const double z = points[j].z() - origin.z();
    const double range_m = std::sqrt(x * x + y * y + z * z);
    if (!(range_m > 0.0 && std::isfinite(range_m))) continue;
    const Entry entry{x / range_m, y / range_m, z / range_m, static_cast<float>(range_m),
                      static_cast<std::int32_t>(j)};
    const int cell = cells.Before(CellIndex(CellOf(entry.x), CellOf(entry.y), CellOf(entry.z)));
    unsorted.push_back(entry);
    cell_of.push_back(static_cast<std::uint16_t>(cell));
    ++begin_[cell + 1];
  }
  for (int c = 0; c < cells.count(); ++c) begin_[c + 1] += begin_[c];
  entries_.resize(unsorted.size());
  std::vector<std::int32_t> next(begin_.begin(), begin_.end() - 1);
  for (std::size_t i = 0; i < unsorted.size(); ++i) entries_[next[cell_of[i]]++] = unsorted[i];
}

void RangeIndex::Search(const Eigen::Vector3d& direction, double reach, double& best_dot,
                        const Entry*& best) const {
  const SphereCells& cells = Cells();
  const int x_low = CellOf(direction.x() - reach);
  const int x_high = CellOf(direction.x() + reach);
  const int y_low = CellOf(direction.y() - reach);
  const int y_high = CellOf(direction.y() + reach);
  const int z_low = CellOf(direction.z() - reach);
  const int z_high = CellOf(direction.z() + reach);
  for (int z = z_low; z <= z_high; ++z) {
    for (int y = y_low; y <= y_high; ++y) {
      const int row = CellIndex(0, y, z);
      const Entry* entry = entries_.data() + begin_[cells.Before(row + x_low)];
      const Entry* const end = entries_.data() + begin_[cells.Before(row + x_high + 1)];
      for (; entry != end; ++entry) {
        const double dot =
            entry->x * direction.x() + entry->y * direction.y() + entry->z * direction.z();
        if (dot > best_dot || (dot == best_dot && entry->point < best->point)) {
          best_dot = dot;
          best = entry;
        }
      }
    }
  }
}

std::optional<RangeIndex::Hit> RangeIndex::Nearest(const Eigen::Vector3d& direction) const {
  if (!direction.allFinite()) return std::nullopt;
  // A look around the cell at hand mostly finds some point; a nearer one can then only be within
  // that one's distance.
  constexpr double kRounding = 1e-9;
  const double near_reach = std::min(0.35 * kCell, max_chord_);
  double best_dot = -2.0;
  const Entry* best = nullptr;
  Search(direction, near_reach, best_dot, best);
  const double chord =
      best == nullptr ? max_chord_ : std::sqrt(std::max(2.0 * (1.0 - best_dot), 0.0)) + kRounding;
  if (chord > near_reach) Search(direction, std::min(chord, max_chord_), best_dot, best);
  if (best == nullptr || !(1.0 - best_dot < epsilon_)) return std::nullopt;
  return Hit{best->point, best->range_m};
}

}  // namespace soundmap::ray_casting
