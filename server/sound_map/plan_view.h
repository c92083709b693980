#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "sound_map/snapshot.h"
#include "sound_map/sound_sources.h"

namespace soundmap::sound_map {

// The floor plan under the picture. Row-major, x fastest, as building::FloorPlan.
struct PlanImage {
  int width = 0;
  int height = 0;
  double cell_size_m = 0.05;
  Eigen::Vector2d origin_in_map_m = Eigen::Vector2d::Zero();
  std::vector<std::uint8_t> cells;  // 0 unknown, 1 free, 2 occupied
};

struct PlanViewOptions {
  std::string title = "Sound map";
  std::uint32_t min_updates = 0;  // epsilon_C
  double min_probability = 0.5;   // of the sources that are marked
  int max_plot_pixels = 1400;     // longer side of the map in the picture, 200 .. 8000
  bool floor_plan_only = false;   // without the legend of the sound
};

// The map from above as a PNG, like the paper's Figs. 8 and 10: per column of voxels the largest
// log-odds as colour over the floor plan, with axes in metres, scale bar, colour bar, and the
// sources numbered and listed in the order given. InvalidArgument: a plan whose cells do not fit
// its size.
absl::StatusOr<std::string> RenderPlanView(const Snapshot& snapshot,
                                           const std::optional<PlanImage>& plan,
                                           std::span<const SoundSource> sources,
                                           const PlanViewOptions& options = {});

}  // namespace soundmap::sound_map
