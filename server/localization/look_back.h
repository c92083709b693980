#pragma once

#include <deque>
#include <optional>
#include <random>
#include <vector>

#include "localization/health.h"
#include "localization/kept_scan.h"
#include "localization/particle_filter.h"
#include "localization/pose_history.h"
#include "localization/prepared_plan.h"

namespace soundmap::localization {

// The filter backwards in time: from the place where a robot found itself again over the scans
// kept while it was lost, to where its scans stop to fit (it was carried there, or the map is wrong
// there). In pieces, so that no call takes long.
struct LookBack {
  std::vector<Particle> particles;  // at the time of the oldest scan looked at
  frames::TimeNs at_ns = 0;         // of it
  Health health;
  std::vector<Correction> found;  // newest first
};

LookBack BeginLookBack(const std::vector<Particle>& particles, const Correction& from);

// Looks at up to `max_scans` of `kept` (oldest first) from `until_ns` on; false once there is none
// left.
bool Continue(const PreparedPlan& plan, const std::deque<KeptScan>& kept, frames::TimeNs until_ns,
              int max_scans, std::mt19937_64& engine, LookBack& look_back);

// The estimate of particles that a scan has just corrected: refined, with its scan fit; the state
// is left open.
PoseEstimate Estimate(const PreparedPlan& plan, frames::TimeNs stamp_ns,
                      const std::vector<Beam>& beams, const std::vector<Particle>& particles);

// After a jump of the odometry.
void Spread(const Config& config, std::vector<Particle>& particles, std::mt19937_64& engine);

}  // namespace soundmap::localization
