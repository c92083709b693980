#include "localization/particle_filter.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

// Returns the logarithm of the sum that the weights had.
double Normalize(std::vector<Particle>& particles) {
  double largest = particles.front().log_weight;
  for (const Particle& particle : particles) largest = std::max(largest, particle.log_weight);
  double sum = 0.0;
  for (const Particle& particle : particles) sum += std::exp(particle.log_weight - largest);
  const double log_sum = largest + std::log(sum);
  for (Particle& particle : particles) particle.log_weight -= log_sum;
  return log_sum;
}

}  // namespace

std::vector<Particle> Scatter(const geometry::Pose2& map_from_base, double position_std_m,
                              double yaw_std_rad, int count, std::mt19937_64& engine) {
  std::normal_distribution<double> normal;
  std::vector<Particle> particles(count);
  for (Particle& particle : particles) {
    const double x_m = map_from_base.x_m + position_std_m * normal(engine);
    const double y_m = map_from_base.y_m + position_std_m * normal(engine);
    const double yaw_rad = map_from_base.yaw_rad + yaw_std_rad * normal(engine);
    particle = {{x_m, y_m, geometry::NormalizeAngle(yaw_rad)}, -std::log(count)};
  }
  return particles;
}

void Predict(const MotionModel& motion, std::vector<Particle>& particles, std::mt19937_64& engine) {
  for (Particle& particle : particles) {
    particle.map_from_base = motion.Sample(particle.map_from_base, engine);
  }
}

double Correct(const std::vector<Beam>& beams, const BeamCaster& caster, const BeamModel& model,
               double tempering, std::vector<Particle>& particles) {
  const std::size_t count = particles.size();
  std::vector<float> cos_yaw(count);
  std::vector<float> sin_yaw(count);
  for (std::size_t p = 0; p < count; ++p) {
    cos_yaw[p] = static_cast<float>(std::cos(particles[p].map_from_base.yaw_rad));
    sin_yaw[p] = static_cast<float>(std::sin(particles[p].map_from_base.yaw_rad));
  }
  std::vector<Ray> rays(count);
  std::vector<Return> expected(count);
  std::vector<double> log_likelihood(count, 0.0);
  // Beam by beam: one beam's rays of all particles cross the same cells.
  for (const Beam& beam : beams) {
    const Eigen::Vector2f origin = beam.origin_in_base_m.cast<float>();
    const Eigen::Vector2f direction = beam.direction_in_base.cast<float>();
    for (std::size_t p = 0; p < count; ++p) {
      const float c = cos_yaw[p];
      const float s = sin_yaw[p];
      rays[p] = {
          static_cast<float>(particles[p].map_from_base.x_m) + c * origin.x() - s * origin.y(),
          static_cast<float>(particles[p].map_from_base.y_m) + s * origin.x() + c * origin.y(),
          c * direction.x() - s * direction.y(), s * direction.x() + c * direction.y()};
    }
    caster.Cast(rays, expected);
    const std::span<const float> row = model.Row(beam.range_m);
    for (std::size_t p = 0; p < count; ++p) log_likelihood[p] += row[model.Column(expected[p])];
  }
  for (std::size_t p = 0; p < count; ++p) particles[p].log_weight += tempering * log_likelihood[p];
  return Normalize(particles);
}

double EffectiveParticles(const std::vector<Particle>& particles) {
  double sum_of_squares = 0.0;
  for (const Particle& particle : particles) sum_of_squares += std::exp(2.0 * particle.log_weight);
  return 1.0 / sum_of_squares;
}

std::vector<Particle> Resample(const std::vector<Particle>& particles, int count,
                               std::mt19937_64& engine) {
  const double step = 1.0 / count;
  double pointer = std::uniform_real_distribution<double>(0.0, step)(engine);
  std::vector<Particle> drawn;
  drawn.reserve(count);
  std::size_t chosen = 0;
  double cumulated = std::exp(particles[0].log_weight);
  for (int i = 0; i < count; ++i, pointer += step) {
    while (pointer > cumulated && chosen + 1 < particles.size()) {
      cumulated += std::exp(particles[++chosen].log_weight);
    }
    drawn.push_back({particles[chosen].map_from_base, std::log(step)});
  }
  return drawn;
}

int AdaptiveCount(const std::vector<Particle>& particles, const AdaptiveConfig& config) {
  std::set<std::array<int, 3>> bins;
  for (const Particle& particle : particles) {
    bins.insert({static_cast<int>(std::floor(particle.map_from_base.x_m / config.bin_m)),
                 static_cast<int>(std::floor(particle.map_from_base.y_m / config.bin_m)),
                 static_cast<int>(std::floor(particle.map_from_base.yaw_rad / config.bin_rad))});
  }
  if (bins.size() < 2) return config.min_particles;
  // Equation (7) there: the Wilson-Hilferty approximation of the chi-square quantile.
  const double degrees = static_cast<double>(bins.size() - 1);
  const double part = 2.0 / (9.0 * degrees);
  const double root = 1.0 - part + std::sqrt(part) * config.quantile;
  const double count = degrees / (2.0 * config.max_divergence) * root * root * root;
  return std::clamp(static_cast<int>(std::min(std::ceil(count), 1e9)), config.min_particles,
                    config.max_particles);
}

Distribution Summarize(const std::vector<Particle>& particles) {
  double x_m = 0.0;
  double y_m = 0.0;
  double cos_yaw = 0.0;
  double sin_yaw = 0.0;
  for (const Particle& particle : particles) {
    const double weight = std::exp(particle.log_weight);
    x_m += weight * particle.map_from_base.x_m;
    y_m += weight * particle.map_from_base.y_m;
    cos_yaw += weight * std::cos(particle.map_from_base.yaw_rad);
    sin_yaw += weight * std::sin(particle.map_from_base.yaw_rad);
  }
  Distribution distribution;
  distribution.mean = {x_m, y_m, std::atan2(sin_yaw, cos_yaw)};
  for (const Particle& particle : particles) {
    const Eigen::Vector3d deviation(
        particle.map_from_base.x_m - x_m, particle.map_from_base.y_m - y_m,
        geometry::NormalizeAngle(particle.map_from_base.yaw_rad - distribution.mean.yaw_rad));
    distribution.covariance += std::exp(particle.log_weight) * deviation * deviation.transpose();
  }
  return distribution;
}

}  // namespace soundmap::localization
