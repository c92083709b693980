#pragma once

#include <cstdint>

#include "absl/status/status.h"

namespace soundmap::sound_map {

// What becomes of log-odds that leave [min_log_odds, max_log_odds].
enum class StopRule {
  kFreeze,  // section V: the update that leaves the interval counts, later ones do not; M and U go on
  kClamp,   // held at the limit, so that a source that stopped is unlearnt
};

enum class SourceMethod {
  kKMeans,      // section VI: k-means over the voxels with L > 0, seeded with the local maxima of L
  kSmoothPeak,  // maxima of the smoothed log-odds, one a neighbourhood
};

// How sound sources are read out of the map.
struct SoundSourceConfig {
  SourceMethod method = SourceMethod::kSmoothPeak;
  std::uint32_t min_updates = 0;  // epsilon_C: voxels with M > min_updates take part
  int max_sources = 256;          // the most probable ones are kept
  int max_voxels = 200'000;       // positive voxels that take part; with more, those of the largest log-odds

  // kKMeans
  int max_seeds = 1024;     // with more local maxima, those of the largest log-odds
  int max_iterations = 50;  // of Lloyd's algorithm

  // kSmoothPeak
  double smoothing_sigma_m = 0.10;    // of the Gaussian over the log-odds
  double separation_m = 0.50;         // two sources are at least this far apart
  double core_radius_m = 0.35;        // voxels of a source lie within this distance of its peak
  std::uint32_t min_evidence = 20;    // fewer supporting observations make no source
  double full_evidence = 60.0;        // supporting observations that lend the log-odds half of their weight

  absl::Status Validate() const;
};

struct SoundMapConfig {
  double voxel_size_m = 0.05;
  StopRule stop_rule = StopRule::kClamp;
  double min_log_odds = -20.0;
  double max_log_odds = 40.0;
  SoundSourceConfig sources;

  // InvalidArgument with a sentence that names the field at fault.
  absl::Status Validate() const;
};

// Sections V and VI to the letter.
SoundMapConfig PaperConfig();
SoundMapConfig DefaultConfig();

}  // namespace soundmap::sound_map
