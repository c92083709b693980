#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "soundmap/poses.h"

namespace soundmap::cli {

struct TrueSource {
  Vector3 position_in_map_m;
  double extent_m = 0.0;
  std::string kind;
  double level = 1.0;
  // Seconds after the drive's start; absent: from its start, to its end.
  std::optional<double> on_s;
  std::optional<double> off_s;
};

// What is true of a scene (NAME.truth.json beside a drive), in `map`.
struct SceneTruth {
  std::vector<TrueSource> sources;
  std::optional<Vector3> room_size_m;  // a box from the origin
  std::vector<Box> obstacles;
};

// InvalidArgument names the file and the field.
absl::StatusOr<SceneTruth> ReadTruthFile(const std::string& path);

}  // namespace soundmap::cli
