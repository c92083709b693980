#pragma once

#include <Eigen/Core>
#include <random>
#include <vector>

#include "geometry/pose.h"
#include "localization/beam_caster.h"
#include "localization/beam_model.h"
#include "localization/motion_model.h"
#include "localization/scan_beams.h"

namespace soundmap::localization {

struct Particle {
  geometry::Pose2 map_from_base;
  double log_weight = 0.0;  // the weights are normalised: exp() adds up to 1

  bool operator==(const Particle&) const = default;
};

// Weighted mean (yaw on the circle) and covariance of x_m, y_m, yaw_rad.
struct Distribution {
  geometry::Pose2 mean;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

// The steps of section II-A's particle filter, from particles to particles.

// `count` particles around a pose, equally likely.
std::vector<Particle> Scatter(const geometry::Pose2& map_from_base, double position_std_m,
                              double yaw_std_rad, int count, std::mt19937_64& engine);

// Prediction.
void Predict(const MotionModel& motion, std::vector<Particle>& particles, std::mt19937_64& engine);

// Correction: the weights take the likelihood of the beams, to the power of `tempering`, and are
// normalised. Returns the logarithm of the mean likelihood, to that power, under the old weights.
double Correct(const std::vector<Beam>& beams, const BeamCaster& caster, const BeamModel& model,
               double tempering, std::vector<Particle>& particles);

// N_eff = 1 / sum of squared weights, between 1 and the number of particles.
double EffectiveParticles(const std::vector<Particle>& particles);

// `count` particles by low-variance resampling (Probabilistic Robotics, table 4.4); equal weights.
std::vector<Particle> Resample(const std::vector<Particle>& particles, int count,
                               std::mt19937_64& engine);

// How many particles hold the distribution's shape (KLD sampling, Fox, IJRR 2003): from the number
// of bins that the particles occupy.
int AdaptiveCount(const std::vector<Particle>& particles, const AdaptiveConfig& config);

Distribution Summarize(const std::vector<Particle>& particles);

}  // namespace soundmap::localization
