#include "localization/config.h"

#include <cmath>

#include "absl/strings/str_cat.h"

namespace soundmap::localization {
namespace {

struct Limit {
  const char* name;
  double value;
  double min;
  double max;
};

}  // namespace

absl::Status Config::Validate() const {
  const Limit limits[] = {
      {"particles", static_cast<double>(particles), 2, 100000},
      {"correction_distance_m", correction_distance_m, 0, 100},
      {"correction_turn_rad", correction_turn_rad, 0, geometry::kPi},
      {"beams", static_cast<double>(beams), 1, 10000},
      {"min_beams", static_cast<double>(min_beams), 1, 10000},
      {"tempering", tempering, 1e-6, 1},
      {"resample_below", resample_below, 0, 1},
      {"min_range_m", min_range_m, 0, 10},
      {"laser_lag_s", laser_lag_s.value_or(0.0), -1, 1},
      {"unknown_gap_m", unknown_gap_m, 0, 10},
      {"max_speed_mps", max_speed_mps, 0.01, 1000},
      {"max_turn_rate_radps", max_turn_rate_radps, 0.01, 1000},
      {"jump_position_std_m", jump_position_std_m, 0, 100},
      {"jump_yaw_std_rad", jump_yaw_std_rad, 0, geometry::kPi},
      {"max_waiting_scans", static_cast<double>(max_waiting_scans), 1, 1000},
      {"motion.rotation_from_rotation", motion.rotation_from_rotation, 0, 100},
      {"motion.rotation_from_translation", motion.rotation_from_translation, 0, 100},
      {"motion.translation_from_translation", motion.translation_from_translation, 0, 100},
      {"motion.translation_from_rotation", motion.translation_from_rotation, 0, 100},
      {"motion.floor_position_m", motion.floor_position_m, 0, 10},
      {"motion.floor_yaw_rad", motion.floor_yaw_rad, 0, geometry::kPi},
      {"beam_model.hit_weight", beam_model.hit_weight, 0, 1},
      {"beam_model.short_weight", beam_model.short_weight, 0, 1},
      {"beam_model.max_weight", beam_model.max_weight, 0, 1},
      // Without a random part one stray beam rules out every particle.
      {"beam_model.random_weight", beam_model.random_weight, 1e-6, 1},
      {"beam_model.hit_std_m", beam_model.hit_std_m, 0.001, 10},
      {"beam_model.short_rate_per_m", beam_model.short_rate_per_m, 1e-3, 1000},
      {"beam_model.resolution_m", beam_model.resolution_m, 0.001, 1},
      {"beam_model.max_range_m", beam_model.max_range_m, 0.1, 3000 * beam_model.resolution_m},
      {"refinement.line_radius_m", refinement.line_radius_m, 0.01, 5},
      {"refinement.gate_m", refinement.gate_m, 0.01, 2},
      {"refinement.range_std_m", refinement.range_std_m, 0.001, 1},
      {"refinement.beam_correlation", refinement.beam_correlation, 1, 10000},
      {"refinement.prior_scale", refinement.prior_scale, 0.1, 1000},
      {"refinement.max_shift_m", refinement.max_shift_m, 0, 10},
      {"refinement.max_turn_rad", refinement.max_turn_rad, 0, geometry::kPi},
      {"refinement.max_iterations", static_cast<double>(refinement.max_iterations), 1, 1000},
      {"health.fit_tolerance_m", health.fit_tolerance_m, 0.001, 10},
      {"health.fit_tolerance_share", health.fit_tolerance_share, 0, 1},
      {"health.fit_memory", health.fit_memory, 1, 10000},
      {"health.slow_memory", health.slow_memory, 1, 10000},
      {"health.usual_share", health.usual_share, 0, 1},
      {"health.sudden_share", health.sudden_share, 0, 1},
      {"health.lost_fit", health.lost_fit, 0, 1},
      {"health.tracking_fit", health.tracking_fit, health.lost_fit, 1},
      {"health.chance_fit", health.chance_fit, 0, health.lost_fit},
      {"health.lost_chance_m", health.lost_chance_m, 0, 1e6},
      {"health.lost_misfit_m", health.lost_misfit_m, 0, 1e6},
      {"health.tracking_position_std_m", health.tracking_position_std_m, 0, 100},
      {"health.tracking_yaw_std_rad", health.tracking_yaw_std_rad, 0, 100},
      {"health.lost_position_std_m", health.lost_position_std_m, 0, 1000},
      {"health.tracking_travel_m", health.tracking_travel_m, 0, 1e6},
      {"health.lost_travel_m", health.lost_travel_m, health.tracking_travel_m, 1e6},
      {"search.cell_m", search.cell_m, 0.01, 10},
      {"search.field_std_m", search.field_std_m, 0.01, 10},
      {"search.yaw_step_rad", search.yaw_step_rad, 0.001, geometry::kPi},
      {"search.max_range_m", search.max_range_m, 0.1, 200},
      {"search.sectors", static_cast<double>(search.sectors), 1, 360},
      {"search.max_points", static_cast<double>(search.max_points), 10, 10000},
      {"search.max_evaluations", static_cast<double>(search.max_evaluations), 1, 1e8},
      {"search.max_candidates", static_cast<double>(search.max_candidates), 1, 1000},
      {"search.min_score", search.min_score, 0, 1},
      {"search.window_m", search.window_m, 0, 1000},
      {"search.window_step_m", search.window_step_m, 0.01, 1000},
      {"search.apart_m", search.apart_m, 0, 100},
      {"search.apart_rad", search.apart_rad, 0, geometry::kPi},
      {"search.scatter_m", search.scatter_m, 0, 10},
      {"search.scatter_rad", search.scatter_rad, 0, geometry::kPi},
      {"search.hypothesis_particles", static_cast<double>(search.hypothesis_particles), 2, 10000},
      {"search.max_hypotheses", static_cast<double>(search.max_hypotheses), 1, 1000},
      {"search.evidence_travel_m", search.evidence_travel_m, 0.1, 1000},
      {"search.recent_travel_m", search.recent_travel_m, 0.01, 1000},
      {"search.min_lead", search.min_lead, 0.001, 100},
      {"search.min_lead_m", search.min_lead_m, 0, 100},
      {"search.carried_lead_m", search.carried_lead_m, search.min_lead_m, 100},
      {"search.give_up_margin", search.give_up_margin, search.min_lead, 100},
      {"search.min_fit", search.min_fit, health.tracking_fit, 1},
      // More fades away before it is reached.
      {"search.min_travel_m", search.min_travel_m, 0, 0.9 * search.evidence_travel_m},
      {"search.max_kept_scans", static_cast<double>(search.max_kept_scans), 1, 100000},
      {"search.look_back_scans", static_cast<double>(search.look_back_scans), 1, 100000},
      {"adaptive.min_particles", static_cast<double>(adaptive.min_particles), 2, 100000},
      {"adaptive.max_particles", static_cast<double>(adaptive.max_particles),
       static_cast<double>(adaptive.min_particles), 100000},
      {"adaptive.bin_m", adaptive.bin_m, 0.001, 100},
      {"adaptive.bin_rad", adaptive.bin_rad, 0.001, geometry::kPi},
      {"adaptive.max_divergence", adaptive.max_divergence, 1e-4, 10},
      {"adaptive.quantile", adaptive.quantile, 0, 10},
  };
  for (const Limit& limit : limits) {
    if (!(limit.value >= limit.min && limit.value <= limit.max)) {
      return absl::InvalidArgumentError(absl::StrCat("localization.", limit.name, " is ",
                                                     limit.value, ", outside ", limit.min, " to ",
                                                     limit.max));
    }
  }
  const double weights = beam_model.hit_weight + beam_model.short_weight + beam_model.max_weight +
                         beam_model.random_weight;
  if (std::abs(weights - 1.0) > 1e-6) {
    return absl::InvalidArgumentError(
        absl::StrCat("localization.beam_model's four weights add up to ", weights, ", not 1"));
  }
  return absl::OkStatus();
}

Config DefaultConfig() { return Config(); }

Config PaperConfig() {
  Config config;
  config.refinement.enabled = false;
  config.search.enabled = false;
  config.laser_lag_s = 0.0;
  return config;
}

}  // namespace soundmap::localization
