#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sources/simulation/scene.h"

namespace soundmap::simulation {

struct SimulateOptions {
  bool mapping =
      false;  // drive the scene as a mapping drive: no audio, another seed, an hour earlier
  std::optional<double> seconds;               // end the drive after so long
  std::function<void(double share)> progress;  // from 0 to 1, now and then
};

struct SimulateResult {
  double duration_s = 0.0;
  std::int64_t messages = 0;
  std::int64_t clipped_samples = 0;
  std::string truth_path;
};

// The file of a scene: `scene` itself if it is one, otherwise NAME.json among the shipped scenes,
// next to the program
// (../share/soundmap/scenes) or in the source tree. NotFound names the shipped ones.
absl::StatusOr<std::string> FindScene(const std::string& scene);

// Drives a robot through the scene and writes the recording and, beside it, its truth (NAME.mcap,
// NAME.truth.json). `scene` as in FindScene. The same scene gives the same bytes.
absl::StatusOr<SimulateResult> Simulate(const std::string& scene, const std::string& out_path,
                                        const SimulateOptions& options);
// The same of a scene that is no file.
absl::StatusOr<SimulateResult> Simulate(const Scene& scene, const std::string& out_path,
                                        const SimulateOptions& options);

}  // namespace soundmap::simulation
