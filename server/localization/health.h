#pragma once

#include <vector>

#include "localization/beam_caster.h"
#include "localization/config.h"
#include "localization/pose_estimate.h"
#include "localization/scan_beams.h"

namespace soundmap::localization {

// The share of beams that end where the map says, of those that by the map end at a wall (taken as
// a fifth of all beams when they are fewer): 0 .. 1.
double ScanFit(const std::vector<Beam>& beams, const geometry::Pose2& map_from_base,
               const BeamCaster& caster, const HealthConfig& config);

// How well the scans fit along a drive.
struct Health {
  double mean_fit = 0.0;  // over the newest fit_memory scans
  double slow_fit = 0.0;  // over slow_memory times as many
  double misfit_m = 0.0;  // driven since the mean fit was last at tracking_fit
  bool misfit = false;    // lost by the rule of the scan fit
  double chance_m = 0.0;  // driven since the mean fit was last at chance_fit

  void Begin(double scan_fit);
  // `is_usual`: the slow mean takes part.
  void Take(double scan_fit, double driven_m, bool is_usual, const HealthConfig& config);
  // The scans fit so much worse than they should, or than they did, that the robot may be
  // elsewhere.
  bool IsDoubtful(double scan_fit, const HealthConfig& config) const;
  // By the fits alone; `scan_fit` of the newest scan.
  State Judge(double scan_fit, const HealthConfig& config) const;

  bool operator==(const Health&) const = default;
};

}  // namespace soundmap::localization
