#pragma once

#include <optional>

#include "absl/status/status.h"
#include "geometry/angles.h"

namespace soundmap::localization {

// Noise of the odometry, as variances that grow with the square of the motion between two
// corrections (Thrun, Burgard, Fox: Probabilistic Robotics, section 5.4, alpha_1 .. alpha_4), and a
// floor that keeps the particles apart.
struct MotionNoise {
  double rotation_from_rotation = 0.01;              // alpha_1, rad^2 / rad^2
  double rotation_from_translation = 0.01;           // alpha_2, rad^2 / m^2
  double translation_from_translation = 0.01;        // alpha_3, m^2 / m^2
  double translation_from_rotation = 0.002;          // alpha_4, m^2 / rad^2
  double floor_position_m = 0.005;                   // standard deviation, along and across
  double floor_yaw_rad = geometry::RadFromDeg(0.2);  // standard deviation
};

// The four parts of the beam model (Probabilistic Robotics, section 6.3); the weights add up to 1.
struct BeamModelConfig {
  double hit_weight = 0.80;
  double short_weight = 0.06;  // something stands before the wall
  double max_weight = 0.02;    // the reading is the largest one
  double random_weight = 0.12;
  double hit_std_m = 0.08;  // range noise, map error and cell size together
  double short_rate_per_m = 0.5;
  double max_range_m = 30.0;    // a longer reading counts as this one
  double resolution_m = 0.025;  // of the tables, in both ranges
};

// Scan matching of the filter's estimate against the walls, see scan_matcher.h.
struct RefinementConfig {
  bool enabled = true;
  double line_radius_m = 0.2;    // wall cells within it make one piece of wall
  double gate_m = 0.2;           // a beam that ends farther from every wall is left out
  double range_std_m = 0.03;     // of a beam's end across the wall
  double beam_correlation = 10;  // so many neighbouring beams count as one independent measurement
  double prior_scale = 2.0;      // the filter's standard deviations are taken this much larger
  double max_shift_m = 0.15;     // a larger change is refused and the filter's estimate stands
  double max_turn_rad = geometry::RadFromDeg(5.0);
  int max_iterations = 12;
};

// When the robot calls itself uncertain or lost, see Localizer.
struct HealthConfig {
  double fit_tolerance_m =
      0.15;  // a beam is explained when it ends this close to where the map says,
  double fit_tolerance_share = 0.02;     // plus this share of its range
  double fit_memory = 5.0;               // corrections over which the scan fit is averaged
  double slow_memory = 10.0;             // times as many make the slow mean
  double tracking_fit = 0.6;             // below: uncertain
  double usual_share = 0.85;             // of the slow mean: below, something has changed
  double sudden_share = 0.7;             // of it, by a single scan
  double lost_fit = 0.4;                 // below: lost, until tracking_fit is reached
  double tracking_position_std_m = 0.3;  // above: uncertain
  double tracking_yaw_std_rad = geometry::RadFromDeg(10.0);
  double lost_misfit_m = 3.0;  // driven below tracking_fit: above, lost as well
  // Until another place fits better, a robot that had its place believes in it, however much of the
  // building has changed: but not when the map explains no more than it does anywhere.
  double chance_fit = 0.25;
  double lost_chance_m = 1.5;        // driven below it: above, lost
  double lost_position_std_m = 1.5;  // above: lost
  double tracking_travel_m = 2.0;    // driven without a correction: above, uncertain
  double lost_travel_m = 15.0;
};

// How a lost robot looks for its place, see Localizer.
struct SearchConfig {
  bool enabled = true;  // otherwise a robot needs a start, and stays lost once it is
  // The search over the whole plan, see GlobalSearch.
  double cell_m = 0.1;
  double field_std_m =
      0.2;  // of a beam's end: half a cell, half a yaw step at max_range_m, the map
  double yaw_step_rad = geometry::RadFromDeg(2.0);
  double max_range_m = 12.0;    // farther ends of beams move too much in half a yaw step
  int sectors = 8;              // of the circle; one a correction
  int max_points = 200;         // ends of beams to search with
  int max_evaluations = 40000;  // of blocks of the plan in a sector: what a correction may cost
  int max_candidates = 10;      // of a sector
  double min_score = 0.4;       // worse is no candidate
  double window_m = 4.0;        // driven: scans to search with and to weigh candidates by; the
                                // odometry must hold over it
  double window_step_m = 0.4;   // between two of these scans
  // The hypotheses, see Hypotheses.
  double apart_m = 0.6;  // nearer, and turned by less, is the same place
  double apart_rad = geometry::RadFromDeg(15.0);
  double scatter_m = 0.1;  // of a new hypothesis
  double scatter_rad = geometry::RadFromDeg(2.0);
  int hypothesis_particles = 25;
  int max_hypotheses = 40;
  double evidence_travel_m = 3.0;  // over which what a hypothesis explained fades
  double recent_travel_m = 0.5;    // and what it explained lately
  // A beam that the map explains is some 7 more likely (logarithm) than one that it does not; a
  // place wins that leaves a share of them less unexplained than any other, the larger the share
  // the sooner.
  double min_lead = 0.14;       // 2 % of the beams, however far it was driven
  double min_lead_m = 0.35;     // 5 % over 1 m
  double carried_lead_m = 0.7;  // 10 % over 1 m, before a robot with a place gives it up
  double give_up_margin = 2.0;  // one that leaves 30 % more is given up
  double min_fit = 0.75;        // scan fit of the place that wins, and
  double min_travel_m = 1.5;    // driven with it, fading as above
  // Scans that are kept to look back with.
  int max_kept_scans = 2000;  // while lost; the oldest stretch beyond is given up
  int look_back_scans = 20;   // a correction
};

// Particle count by KLD sampling, see AdaptiveCount.
struct AdaptiveConfig {
  bool enabled = false;  // otherwise Config::particles
  int min_particles = 100;
  int max_particles = 2000;
  double bin_m = 0.1;
  double bin_rad = geometry::RadFromDeg(5.0);
  double max_divergence = 0.05;  // Kullback-Leibler, from the true distribution
  double quantile = 2.33;        // of the normal distribution: kept in 99 of 100 cases
};

struct Config {
  int particles = 200;                                     // section II-A
  double correction_distance_m = 0.1;                      // section II-A
  double correction_turn_rad = geometry::RadFromDeg(5.0);  // section II-A
  int beams = 60;      // of a scan, after the invalid ones are dropped
  int min_beams = 15;  // a scan with fewer valid beams corrects nothing
  double tempering =
      0.3;  // exponent of a scan's likelihood: neighbouring beams are not independent
  double resample_below = 0.5;  // N_eff as a share of the particles
  double min_range_m = 0.05;    // a shorter reading is no return
  // The scan stamped t was taken at t - lag on the odometry's clock; none: told from the turns of
  // the first metres, 0 until then.
  std::optional<double> laser_lag_s;
  double unknown_gap_m = 0.3;  // narrower patches of unknown cells are transparent, see BeamCaster
  double max_speed_mps = 5.0;  // faster odometry is a jump, not a motion
  double max_turn_rate_radps = 8.0;
  double jump_position_std_m = 0.2;  // spread added to the particles after a jump
  double jump_yaw_std_rad = geometry::RadFromDeg(10.0);
  int max_waiting_scans = 20;  // scans whose odometry has not arrived; the oldest is dropped
  MotionNoise motion;
  BeamModelConfig beam_model;
  RefinementConfig refinement;
  HealthConfig health;
  SearchConfig search;
  AdaptiveConfig adaptive;

  // InvalidArgument names the parameter.
  absl::Status Validate() const;
};

// The defaults above: the most accurate that we know.
Config DefaultConfig();

// Section II-A as printed: the plain particle filter, its weighted mean is the pose.
Config PaperConfig();

}  // namespace soundmap::localization
