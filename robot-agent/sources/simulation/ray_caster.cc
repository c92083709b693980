#include "sources/simulation/ray_caster.h"

#include <algorithm>
#include <limits>

namespace soundmap::simulation {
namespace {

constexpr double kTouchM = 0.01;

struct Interval {
  double enter_m, leave_m;
  bool hit() const { return enter_m < leave_m; }
};

// Slab method: the part of the ray that lies in the box.
Interval Slabs(const Box& box, const Eigen::Vector3d& origin_m, const Eigen::Vector3d& direction) {
  Interval inside{-std::numeric_limits<double>::infinity(),
                  std::numeric_limits<double>::infinity()};
  for (int axis = 0; axis < 3; ++axis) {
    const double to_min_m = box.min_m[axis] - origin_m[axis];
    const double to_max_m = box.max_m[axis] - origin_m[axis];
    if (direction[axis] == 0.0) {
      if (to_min_m > 0.0 || to_max_m < 0.0) return {1.0, 0.0};
      continue;
    }
    const double a = to_min_m / direction[axis];
    const double b = to_max_m / direction[axis];
    inside.enter_m = std::max(inside.enter_m, std::min(a, b));
    inside.leave_m = std::min(inside.leave_m, std::max(a, b));
  }
  return inside;
}

}  // namespace

RayCaster::RayCaster(const Eigen::Vector3d& room_m, std::vector<Box> furniture)
    : room_m_(room_m), furniture_(std::move(furniture)) {}

double RayCaster::RangeM(const Eigen::Vector3d& origin_m, const Eigen::Vector3d& direction,
                         std::span<const Box> people) const {
  double range_m = Slabs({Eigen::Vector3d::Zero(), room_m_}, origin_m, direction).leave_m;
  const auto see = [&](const Box& box) {
    const Interval inside = Slabs(box, origin_m, direction);
    if (inside.hit() && inside.enter_m > 0.0) range_m = std::min(range_m, inside.enter_m);
  };
  for (const Box& box : furniture_) see(box);
  for (const Box& box : people) see(box);
  return range_m;
}

bool RayCaster::IsBlocked(const Eigen::Vector3d& from_m, const Eigen::Vector3d& to_m,
                          std::span<const Box> people) const {
  const double length_m = (to_m - from_m).norm();
  if (length_m <= 2.0 * kTouchM) return false;
  const Eigen::Vector3d direction = (to_m - from_m) / length_m;
  const auto blocks = [&](const Box& box) {
    const Interval inside = Slabs(box, from_m, direction);
    return inside.hit() && inside.leave_m > kTouchM && inside.enter_m < length_m - kTouchM;
  };
  return std::any_of(furniture_.begin(), furniture_.end(), blocks) ||
         std::any_of(people.begin(), people.end(), blocks);
}

}  // namespace soundmap::simulation
