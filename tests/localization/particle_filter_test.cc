#include "localization/particle_filter.h"

#include <gtest/gtest.h>

#include <cmath>

#include "geometry/angles.h"
#include "synthetic_room.h"

namespace soundmap::localization {
namespace {

using geometry::Pose2;

std::vector<Particle> WithWeights(const std::vector<double>& weights) {
  std::vector<Particle> particles;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    particles.push_back({{static_cast<double>(i), 0.0, 0.0}, std::log(weights[i])});
  }
  return particles;
}

TEST(ParticleFilter, ResamplingIsUnbiasedAndOfLowVariance) {
  const std::vector<double> weights{0.04, 0.31, 0.0, 0.25, 0.17, 0.08, 0.15};
  const auto particles = WithWeights(weights);
  std::mt19937_64 engine(11);
  std::vector<double> sum(weights.size(), 0.0);
  constexpr int kRounds = 20000;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<int> count(weights.size(), 0);
    const auto drawn = Resample(particles, static_cast<int>(particles.size()), engine);
    ASSERT_EQ(drawn.size(), weights.size());
    for (const Particle& particle : drawn) {
      ++count[static_cast<int>(particle.map_from_base.x_m)];
      EXPECT_DOUBLE_EQ(particle.log_weight, -std::log(7.0));
    }
    for (std::size_t i = 0; i < weights.size(); ++i) {
      const double expected = weights[i] * 7.0;
      EXPECT_GE(count[i], std::floor(expected - 1e-9));
      EXPECT_LE(count[i], std::ceil(expected + 1e-9));
      sum[i] += count[i];
    }
  }
  for (std::size_t i = 0; i < weights.size(); ++i) {
    EXPECT_NEAR(sum[i] / kRounds, 7.0 * weights[i], 0.015) << i;
  }
}

TEST(ParticleFilter, EffectiveParticlesOfKnownWeights) {
  EXPECT_NEAR(EffectiveParticles(WithWeights({0.25, 0.25, 0.25, 0.25})), 4.0, 1e-12);
  EXPECT_NEAR(EffectiveParticles(WithWeights({1.0, 0.0, 0.0})), 1.0, 1e-12);
  EXPECT_NEAR(EffectiveParticles(WithWeights({0.5, 0.25, 0.25})), 1.0 / 0.375, 1e-12);
}

TEST(ParticleFilter, SummaryOfYawsAcrossTheCut) {
  std::vector<Particle> particles{{{1.0, 2.0, geometry::kPi - 0.1}, std::log(0.5)},
                                  {{3.0, 2.0, -geometry::kPi + 0.1}, std::log(0.5)}};
  const Distribution distribution = Summarize(particles);
  EXPECT_NEAR(distribution.mean.x_m, 2.0, 1e-12);
  EXPECT_NEAR(std::abs(distribution.mean.yaw_rad), geometry::kPi, 1e-12);
  EXPECT_NEAR(distribution.covariance(0, 0), 1.0, 1e-12);
  EXPECT_NEAR(distribution.covariance(2, 2), 0.01, 1e-12);
  EXPECT_NEAR(distribution.covariance(0, 2), 0.1, 1e-12);
}

TEST(ParticleFilter, ScatterHasTheStatedSpread) {
  std::mt19937_64 engine(5);
  const auto particles = Scatter({1.0, -2.0, 3.1}, 0.2, 0.1, 20000, engine);
  const Distribution distribution = Summarize(particles);
  EXPECT_NEAR(distribution.mean.x_m, 1.0, 0.01);
  EXPECT_NEAR(distribution.mean.y_m, -2.0, 0.01);
  EXPECT_NEAR(std::sqrt(distribution.covariance(0, 0)), 0.2, 0.005);
  EXPECT_NEAR(std::sqrt(distribution.covariance(2, 2)), 0.1, 0.003);
  EXPECT_NEAR(EffectiveParticles(particles), 20000.0, 1e-3);
}

// The weights against sums of logarithms, with ranges from the geometry of the room instead of the
// plan.
TEST(ParticleFilter, CorrectionWeighsByTheTemperedLikelihoodOfTheBeams) {
  const SyntheticRoom room;
  const auto caster = BeamCaster::Create(room.Plan(), 0.3).value();
  BeamModelConfig config;
  config.hit_std_m = 0.3;  // wide, so that the bins of the table do not matter
  const BeamModel model(config);
  const Pose2 truth{1.5, 1.5, 0.4};
  const Eigen::Vector2d laser_in_base(0.2, -0.1);
  const auto range_of = [&](const Pose2& pose, double angle_rad) {
    const double c = std::cos(pose.yaw_rad);
    const double s = std::sin(pose.yaw_rad);
    return room.Range(pose.x_m + c * laser_in_base.x() - s * laser_in_base.y(),
                      pose.y_m + s * laser_in_base.x() + c * laser_in_base.y(),
                      pose.yaw_rad + angle_rad);
  };
  std::vector<Beam> beams;
  for (int i = 0; i < 40; ++i) {
    const double angle_rad = -2.0 + 0.1 * i;
    beams.push_back(
        {laser_in_base, {std::cos(angle_rad), std::sin(angle_rad)}, range_of(truth, angle_rad)});
  }
  std::mt19937_64 engine(2);
  std::vector<Particle> particles = Scatter(truth, 0.1, 0.02, 50, engine);
  particles[0].map_from_base = truth;
  std::vector<double> expected;
  for (const Particle& particle : particles) {
    double log_weight = 0.0;
    for (int i = 0; i < 40; ++i) {
      const double range_m = range_of(particle.map_from_base, -2.0 + 0.1 * i);
      log_weight +=
          0.3 *
          model.Row(beams[i].range_m)[model.Column({static_cast<float>(range_m), Ending::kWall})];
    }
    expected.push_back(log_weight);
  }
  Correct(beams, caster, model, 0.3, particles);
  double sum = 0.0;
  for (std::size_t i = 0; i < particles.size(); ++i) {
    sum += std::exp(particles[i].log_weight);
    EXPECT_NEAR(particles[i].log_weight - particles[0].log_weight, expected[i] - expected[0], 0.15)
        << i;
  }
  EXPECT_NEAR(sum, 1.0, 1e-9);
}

TEST(ParticleFilter, WeightsSurviveLikelihoodsBelowAnyDouble) {
  const SyntheticRoom room;
  const auto caster = BeamCaster::Create(room.Plan(), 0.3).value();
  const BeamModel model{BeamModelConfig{}};
  const std::vector<Beam> beams(5000, Beam{{0.0, 0.0}, {1.0, 0.0}, 0.5});
  std::vector<Particle> particles{{{1.5, 1.5, 0.0}, std::log(0.5)},
                                  {{1.5, 1.5, 0.0}, std::log(0.5)}};
  Correct(beams, caster, model, 1.0, particles);
  EXPECT_NEAR(particles[0].log_weight, std::log(0.5), 1e-6);
}

// Fox, IJRR 2003, equation (7), with the quantile of chi-square from tables: 0.99 at 9 degrees of
// freedom is 21.666, at 49 it is 74.919.
TEST(ParticleFilter, AdaptiveCountFollowsTheBinsTaken) {
  AdaptiveConfig config;
  config.min_particles = 10;
  config.max_particles = 1000;
  for (const auto& [bins, quantile] : {std::pair{10, 21.666}, std::pair{50, 74.919}}) {
    std::vector<Particle> particles;
    for (int i = 0; i < 3 * bins; ++i) {
      particles.push_back({{(i % bins + 0.5) * config.bin_m, 0.05, 0.01}, -std::log(3.0 * bins)});
    }
    EXPECT_NEAR(AdaptiveCount(particles, config), quantile / (2.0 * config.max_divergence),
                0.01 * quantile / (2.0 * config.max_divergence) + 1.0);
    config.max_particles = 300;
    EXPECT_LE(AdaptiveCount(particles, config), 300);
    config.max_particles = 1000;
  }
  const std::vector<Particle> one(50, Particle{{1.0, 1.0, 1.0}, -std::log(50.0)});
  EXPECT_EQ(AdaptiveCount(one, config), 10);
}

}  // namespace
}  // namespace soundmap::localization
