#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "sources/simulation/scene.h"

namespace soundmap::simulation {

// Distance along a ray to the room's walls, furniture and people: exact. All are opaque boxes; the
// room is seen from within.
class RayCaster {
 public:
  RayCaster(const Eigen::Vector3d& room_m, std::vector<Box> furniture);

  // `direction` has unit length; the origin lies in the room. A box around the origin is not seen.
  double RangeM(const Eigen::Vector3d& origin_m, const Eigen::Vector3d& direction,
                std::span<const Box> people = {}) const;

  // Whether furniture or people stand between two points; touching the first or last centimetre
  // does not count.
  bool IsBlocked(const Eigen::Vector3d& from_m, const Eigen::Vector3d& to_m,
                 std::span<const Box> people = {}) const;

 private:
  Eigen::Vector3d room_m_;
  std::vector<Box> furniture_;
};

}  // namespace soundmap::simulation
