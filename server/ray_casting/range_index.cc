#include "ray_casting/range_index.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

// LIDAR points mostly lie closer together: a look that far around a direction finds one.
constexpr double kNear_rad = geometry::RadFromDeg(1.4);

constexpr float kFarFromAll = 4.0f;  // no unit vector is near

}  // namespace

LookUpDirections::LookUpDirections(geometry::DirectionGrid directions, double max_angle_rad)
    : grid_(std::move(directions)),
      epsilon_(1.0 - std::cos(max_angle_rad)),
      max_chord_(static_cast<float>(2.0 * std::sin(0.5 * max_angle_rad))) {
  const double near_rad = std::min(kNear_rad, max_angle_rad);
  near_chord_ = std::max(
      0.0f, static_cast<float>(2.0 * std::sin(0.5 * near_rad)) - 5.0f * SphereCells::kRounding);
  const auto append = [](const Eigen::Vector3d& direction, double angle_rad, Rows* rows) {
    rows->begin.push_back(static_cast<std::int32_t>(rows->row.size()));
    if (!direction.allFinite()) return;
    SphereCells::Get().AppendRowsWithin(direction.cast<float>(),
                                        static_cast<float>(angle_rad) + SphereCells::kRounding,
                                        &rows->row);
  };
  for (const Eigen::Vector3d& direction : grid_) {
    for (int axis = 0; axis < 3; ++axis) axis_[axis].push_back(static_cast<float>(direction[axis]));
    append(direction, near_rad, &near_);
    append(direction, max_angle_rad, &far_);
  }
  for (Rows* rows : {&near_, &far_}) {
    rows->begin.push_back(static_cast<std::int32_t>(rows->row.size()));
  }
}

void RangeIndex::Make(std::span<const Eigen::Vector3f> points,
                      const Eigen::Isometry3d& base_from_array) {
  points_ = points;
  base_from_array_ = base_from_array;
  cell_.resize(points.size());
  UnitVectors vectors{.points = points,
                      .turn = base_from_array.linear().transpose().cast<float>(),
                      .cell = cell_.data()};
  for (int axis = 0; axis < 3; ++axis) {
    const double origin = base_from_array.translation()[axis];
    vectors.origin_high[axis] = static_cast<float>(origin);
    vectors.origin_low[axis] = static_cast<float>(origin - vectors.origin_high[axis]);
    unsorted_[axis].resize(points.size());
    vectors.unit[axis] = unsorted_[axis].data();
  }
  kernels_.make_unit_vectors(vectors);
  SortIntoCells();
}

void RangeIndex::SortIntoCells() {
  const std::size_t count = points_.size();
  // Counted a place later, so that the places of a cell's points end where they begin before. The
  // last cell takes what is never found.
  begin_.assign(SphereCells::Get().size() + 3, 0);
  for (std::size_t j = 0; j < count; ++j) ++begin_[cell_[j] + 2];
  for (std::size_t c = 2; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
  for (std::vector<float>& axis : unit_) axis.resize(count + kPadding);
  point_.resize(count + kPadding);
  for (std::size_t j = 0; j < count; ++j) {
    const std::int32_t at = begin_[cell_[j] + 1]++;
    for (int axis = 0; axis < 3; ++axis) unit_[axis][at] = unsorted_[axis][j];
    point_[at] = static_cast<std::int32_t>(j);
  }
  for (std::vector<float>& axis : unit_) std::fill(axis.end() - kPadding, axis.end(), kFarFromAll);
}

std::vector<std::int32_t> RangeIndex::Nearest(const LookUpDirections& directions) const {
  std::vector<std::int32_t> nearest(directions.size());
  const float within = std::max(0.0f, directions.max_chord_ - 5.0f * SphereCells::kRounding);
  const float beyond = directions.max_chord_ + 5.0f * SphereCells::kRounding;
  const SortedPoints points{.unit = {unit_[0].data(), unit_[1].data(), unit_[2].data()},
                            .point = point_.data(),
                            .begin = begin_.data(),
                            .within_chord2 = within * within,
                            .beyond_chord2 = beyond * beyond};
  const Directions in{
      .axis = {directions.axis_[0].data(), directions.axis_[1].data(), directions.axis_[2].data()},
      .count = directions.size(),
      .near = directions.near_.View(),
      .near_chord2 = directions.near_chord_ * directions.near_chord_,
      .far = directions.far_.View()};
  kernels_.find_nearest(points, in, nearest.data());
  for (int i = 0; i < directions.size(); ++i) {
    if (nearest[i] == kUndecided) nearest[i] = DecideInDouble(directions, i);
  }
  return nearest;
}

std::vector<std::uint64_t> RangeIndex::EndKeys(const LookUpDirections& directions,
                                               std::span<const std::int32_t> nearest,
                                               const Eigen::Isometry3d& map_from_array,
                                               double max_range_m, double voxel_size_m) const {
  std::vector<std::uint64_t> key(nearest.size(), kNoKey);
  if (points_.empty()) return key;
  FindEndKeys({.points = points_.data(),
               .direction_in_array = &directions.grid_[0],
               .nearest = nearest.data(),
               .count = static_cast<int>(nearest.size()),
               .base_from_array_m = base_from_array_.translation(),
               .map_from_array = map_from_array,
               .max_range_m = max_range_m,
               .voxel_size_m = voxel_size_m,
               .key = key.data()});
  return key;
}

// Of the points that are nearest but for rounding, the nearest in double precision.
std::int32_t RangeIndex::DecideInDouble(const LookUpDirections& directions, int i) const {
  const auto visit = [&](auto&& visit_chord2) {
    for (std::int32_t r = directions.far_.begin[i]; r < directions.far_.begin[i + 1]; ++r) {
      const SphereCells::Row& row = directions.far_.row[r];
      for (std::int32_t at = begin_[row.begin]; at < begin_[row.end]; ++at) {
        float chord2 = 0.0f;
        for (int axis = 0; axis < 3; ++axis) {
          const float along = unit_[axis][at] - directions.axis_[axis][i];
          chord2 += along * along;
        }
        visit_chord2(at, chord2);
      }
    }
  };
  float least = std::numeric_limits<float>::infinity();
  visit([&](std::int32_t, float chord2) { least = std::min(least, chord2); });
  const float limit = least + UndecidedChord2(std::sqrt(least));
  const Eigen::Vector3d direction = base_from_array_.linear() * directions.grid_[i];
  std::int32_t best = kNoPoint;
  double best_dot = 0.0;
  visit([&](std::int32_t at, float chord2) {
    if (chord2 > limit) return;
    const std::int32_t point = point_[at];
    const Eigen::Vector3d v = points_[point].cast<double>() - base_from_array_.translation();
    const double range_m = std::sqrt(v.x() * v.x() + v.y() * v.y() + v.z() * v.z());
    const double dot = v.x() / range_m * direction.x() + v.y() / range_m * direction.y() +
                       v.z() / range_m * direction.z();
    if (best == kNoPoint || dot > best_dot || (dot == best_dot && point < best)) {
      best_dot = dot;
      best = point;
    }
  });
  return best != kNoPoint && 1.0 - best_dot < directions.epsilon_ ? best : kNoPoint;
}

}  // namespace soundmap::ray_casting
