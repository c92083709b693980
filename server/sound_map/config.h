#pragma once

#include <cstdint>

#include "absl/status/status.h"

namespace soundmap::sound_map {

// What becomes of log-odds that leave [min_log_odds, max_log_odds].
enum class StopRule {
  kFreeze,  // section V: the update that leaves the interval counts, later ones do not; M and U go
            // on
  kClamp,   // held at the limit, so that a source that stopped is unlearnt
};

enum class SourceMethod {
  kKMeans,      // section VI: k-means over the voxels with L > 0, seeded with the local maxima of L
  kSmoothPeak,  // places where the share of observations that support a source stands out; see
                // sound_sources.h
};

// How sound sources are read out of the map.
struct SoundSourceConfig {
  SourceMethod method = SourceMethod::kSmoothPeak;
  std::uint32_t min_updates = 0;  // epsilon_C: voxels with M > min_updates take part
  int max_sources = 256;          // the most probable ones are kept
  int max_voxels = 200'000;       // that take part; with more, those that speak most for a source

  // kKMeans
  int max_seeds = 1024;     // with more local maxima, those of the largest log-odds
  int max_iterations = 50;  // of Lloyd's algorithm

  // kSmoothPeak
  double smoothing_sigma_m =
      0.10;  // Gaussian over which observations around a voxel are counted together
  double background_share =
      0.02;  // of the observations of a place without a source support one all the same
  // Ghosts are no chance: they come again from the same place, some many times. So the odds that a
  // place is a source grow with a power of its evidence, the log-likelihood ratio against the
  // background, and are even at this evidence. Both by logistic regression over the candidates of
  // 23 simulated rooms.
  double even_evidence = 70.0;
  double evidence_power = 1.6;
  // Whether the source register judges by how many views heard a place, too; see source_register.h
  bool judge_by_views = true;
  double separation_m = 0.50;  // two sources are at least this far apart
  double masking_radius_m =
      1.2;  // nearer than this to a source, smears and reflections of it are expected:
  double masking_share =
      0.5;  //   a second one needs this share of its evidence, less with distance
  double core_radius_m = 0.30;      // voxels of a source lie within this distance of its centre
  std::uint32_t min_evidence = 20;  // fewer supporting observations make no source

  // Sources as objects; see source_register.h
  double view_point_spacing_m = 1.0;  // robots that stood closer together heard the same
  double gone_after_s = 600.0;        // a source that was listened to so long in silence is gone
  double history_days = 30.0;         // that is kept of when a source was heard

  absl::Status Validate() const;
};

struct SoundMapConfig {
  double voxel_size_m = 0.05;
  StopRule stop_rule = StopRule::kClamp;
  // Where 0.9 speaks for a source and 0.4 against, 10 observations raise a silent voxel above 0 and
  // 50 quiet ones unlearn a loud one.
  double min_log_odds = -10.0;
  double max_log_odds = 20.0;
  SoundSourceConfig sources;

  // InvalidArgument with a sentence that names the field at fault.
  absl::Status Validate() const;
};

// Sections V and VI to the letter.
SoundMapConfig PaperConfig();
SoundMapConfig DefaultConfig();

}  // namespace soundmap::sound_map
