#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "absl/status/statusor.h"
#include "sources/simulation/scene.h"
#include "sources/simulation/trajectory.h"

namespace soundmap::simulation {

// What the moving microphones hear: sources and their mirror images in the room, each as a point
// whose distance to each microphone gives delay and 1/r; a diffuse tail of plane waves from all
// directions that carries the rest of the room's energy; sensor noise.
//
// Delays are exact: frames with a triangular window, half overlapped, are delayed by a whole number
// of samples and then, as spectra, by the rest, for each microphone. They hold for the middle of a
// frame (one hop is about 8 ms) and fade linearly into the next.
class SoundField {
 public:
  // The errors of .wav files; InvalidArgument when the room is too large for its sound to be held
  // in memory.
  static absl::StatusOr<std::unique_ptr<SoundField>> Create(const Scene& scene,
                                                            const Trajectory& trajectory);
  virtual ~SoundField() = default;

  // The next samples of all microphones, interleaved, in the unit of the sources' `level`; the
  // first starts the drive.
  virtual std::span<const float> Next() = 0;

  // An amplitude that the drive's samples hardly pass.
  virtual double expected_peak() const = 0;
};

}  // namespace soundmap::simulation
