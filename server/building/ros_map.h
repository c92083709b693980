#pragma once

#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "building/floor_plan.h"

namespace soundmap::building {

// A map of ROS's map_server: a YAML file that names and explains a grey-scale picture (PGM, 8
// bits).
struct RosMap {
  std::string yaml;
  std::string pgm;
};

// What the YAML names as its picture: a path, relative to the YAML file unless absolute.
absl::StatusOr<std::string> RosMapImagePath(std::string_view yaml);

// Occupied above `occupied_thresh`, free below `free_thresh` (of (255 - grey) / 255, or grey / 255
// with `negate`), else unknown. InvalidArgument: not such files, a turned map (the origin's yaw is
// not 0), the mode `raw`, a truncated picture, too many cells.
absl::StatusOr<FloorPlan> ParseRosMap(std::string_view yaml, std::string_view pgm);

// Occupied 0, free 254, unknown 205, as map_saver writes them. `image_path` is what the YAML shall
// name.
RosMap ToRosMap(const FloorPlan& floor_plan, std::string_view image_path);

}  // namespace soundmap::building
