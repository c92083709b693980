#pragma once

#include <optional>
#include <vector>

#include "building/floor_plan.h"
#include "localization/beam_caster.h"
#include "localization/particle_filter.h"

namespace soundmap::localization {

// Sharpens a pose that is right within some 0.1 m: the ends of all valid beams are laid on straight
// pieces of wall, each a line through the centres of the wall cells around, so that the result is
// not bound to the cells (point-to-line matching, Gauss-Newton with Tukey's weights). The filter's
// distribution is the prior; it holds where the walls say nothing, as along a corridor. Immutable.
class ScanMatcher {
 public:
  // `caster` knows which cells are seen as walls; it is used only here.
  ScanMatcher(const RefinementConfig& config, const building::FloorPlan& plan,
              const BeamCaster& caster);

  // None when too few beams end at walls or the pose would move by more than the configuration
  // allows.
  std::optional<Distribution> Match(const std::vector<Beam>& beams,
                                    const Distribution& prior) const;

 private:
  struct WallPiece {
    Eigen::Vector2d point_in_map_m;
    Eigen::Vector2d normal;
  };

  const WallPiece* Nearest(const Eigen::Vector2d& point_in_map_m) const;

  RefinementConfig config_;
  int width_;
  int height_;
  double cell_size_m_;
  double cells_per_m_;
  Eigen::Vector2d origin_in_map_m_;
  std::vector<WallPiece> pieces_;
  std::vector<std::int32_t> nearest_piece_;  // by cell; -1: none within the gate
};

}  // namespace soundmap::localization
