#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/pose.h"
#include "mapping/surface_map.h"

namespace soundmap::mapping {

// Where to search.
struct SearchWindow {
  geometry::Pose2 centre;
  double half_width_m = 0.0;  // along x and along y
  double half_height_m = 0.0;
  double half_turn_rad = 0.0;  // pi: any heading
};

struct PoseGuess {
  geometry::Pose2 map_from_base;
  double score = 0.0;  // points on steep surfaces that find one, 0 to 1
};

// The rough place of a scan on a map, by trying all poses of a window: its steep surfaces seen from
// above, laid over those of the map.
class PoseSearch {
 public:
  explicit PoseSearch(const SurfaceMap& map);

  // The best, at least a metre or 15 degrees apart, best first.
  std::vector<PoseGuess> Best(std::span<const Eigen::Vector3f> point_in_base,
                              const SearchWindow& window, int count) const;

  // All of the map.
  SearchWindow Everywhere() const;

 private:
  bool IsSurface(float x_m, float y_m) const;

  Eigen::Vector2f origin_m_ = Eigen::Vector2f::Zero();
  int width_ = 0;
  int height_ = 0;
  std::vector<std::uint8_t> cells_;  // 1: a steep surface in this cell or beside it
};

}  // namespace soundmap::mapping
