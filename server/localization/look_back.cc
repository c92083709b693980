#include "localization/look_back.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::localization {

LookBack BeginLookBack(const std::vector<Particle>& particles, const Correction& from) {
  LookBack look_back{particles, from.estimate.stamp_ns, {}, {from}};
  look_back.health.Begin(from.estimate.scan_fit);
  return look_back;
}

bool Continue(const PreparedPlan& plan, const std::deque<KeptScan>& kept, frames::TimeNs until_ns,
              int max_scans, std::mt19937_64& engine, LookBack& look_back) {
  const Config& config = plan.config;
  auto later = std::lower_bound(
      kept.begin(), kept.end(), look_back.at_ns,
      [](const KeptScan& scan, frames::TimeNs wanted_ns) { return scan.stamp_ns < wanted_ns; });
  if (later == kept.end() || later->stamp_ns != look_back.at_ns) return false;
  for (int i = 0; i < max_scans; ++i) {
    if (later == kept.begin() || std::prev(later)->stamp_ns < until_ns) return false;
    const KeptScan& scan = *std::prev(later);
    const geometry::Pose2 moved = later->odom_from_base.Inverse() * scan.odom_from_base;
    Predict(MotionModel(config.motion, moved), look_back.particles, engine);
    if (later->jumped) Spread(config, look_back.particles, engine);
    Correct(scan.beams, plan.caster, plan.model, config.tempering, look_back.particles);
    PoseEstimate estimate = Estimate(plan, scan.stamp_ns, scan.beams, look_back.particles);
    look_back.health.Take(estimate.scan_fit, std::hypot(moved.x_m, moved.y_m), true, config.health);
    // A look back that meets the moment when the robot was carried off does not wait for the mean.
    estimate.state = estimate.scan_fit < config.health.lost_fit
                         ? State::kLost
                         : look_back.health.Judge(estimate.scan_fit, config.health);
    look_back.found.push_back({estimate, scan.odom_from_base});
    if (EffectiveParticles(look_back.particles) <
        config.resample_below * static_cast<double>(look_back.particles.size())) {
      look_back.particles =
          Resample(look_back.particles, static_cast<int>(look_back.particles.size()), engine);
    }
    look_back.at_ns = scan.stamp_ns;
    --later;
  }
  return later != kept.begin() && std::prev(later)->stamp_ns >= until_ns;
}

PoseEstimate Estimate(const PreparedPlan& plan, frames::TimeNs stamp_ns,
                      const std::vector<Beam>& beams, const std::vector<Particle>& particles) {
  Distribution pose = Summarize(particles);
  if (plan.config.refinement.enabled) {
    if (const auto refined = plan.matcher.Match(beams, pose)) pose = *refined;
  }
  PoseEstimate estimate;
  estimate.stamp_ns = stamp_ns;
  estimate.map_from_base = pose.mean;
  estimate.covariance = pose.covariance;
  estimate.effective_particles = EffectiveParticles(particles);
  estimate.scan_fit = ScanFit(beams, pose.mean, plan.caster, plan.config.health);
  return estimate;
}

void Spread(const Config& config, std::vector<Particle>& particles, std::mt19937_64& engine) {
  std::normal_distribution<double> normal;
  for (Particle& particle : particles) {
    particle.map_from_base.x_m += config.jump_position_std_m * normal(engine);
    particle.map_from_base.y_m += config.jump_position_std_m * normal(engine);
    particle.map_from_base.yaw_rad = geometry::NormalizeAngle(
        particle.map_from_base.yaw_rad + config.jump_yaw_std_rad * normal(engine));
  }
}

}  // namespace soundmap::localization
