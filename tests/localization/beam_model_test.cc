#include "localization/beam_model.h"

#include <gtest/gtest.h>

#include <cmath>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

double Probability(const BeamModel& model, double measured_m, const Return& expected) {
  return std::exp(model.Row(measured_m)[model.Column(expected)]);
}

TEST(BeamModel, EachDistributionOfReadingsAddsUpToOne) {
  BeamModelConfig config;
  config.max_range_m = 12.0;
  config.resolution_m = 0.05;
  const BeamModel model(config);
  EXPECT_EQ(model.bins(), 241);
  for (const Ending ending : {Ending::kWall, Ending::kUnknown}) {
    for (const float expected_m : {0.0f, 0.05f, 0.3f, 4.0f, 11.9f, 12.0f, 40.0f}) {
      double sum = 0.0;
      for (int bin = 0; bin < model.bins(); ++bin) {
        sum += Probability(model, bin * config.resolution_m, {expected_m, ending});
      }
      EXPECT_NEAR(sum, 1.0, 1e-5) << expected_m;
    }
  }
}

// Densities in closed form, Probabilistic Robotics eqs. (6.4)-(6.11), with their normalisers.
TEST(BeamModel, FollowsTheFourPartsInClosedForm) {
  const BeamModelConfig config;
  const BeamModel model(config);
  const double r = 4.0;
  const auto density = [&](double z) {
    const double s = config.hit_std_m;
    const double lambda = config.short_rate_per_m;
    const double hit_normalizer = 0.5 * (std::erf((config.max_range_m - r) / (s * std::sqrt(2.0))) +
                                         std::erf(r / (s * std::sqrt(2.0))));
    const double hit = std::exp(-0.5 * (z - r) * (z - r) / (s * s)) /
                       (s * std::sqrt(2.0 * geometry::kPi)) / hit_normalizer;
    const double shorter =
        z <= r ? lambda * std::exp(-lambda * z) / (1.0 - std::exp(-lambda * r)) : 0.0;
    return config.hit_weight * hit + config.short_weight * shorter +
           config.random_weight / config.max_range_m;
  };
  for (const double z : {0.5, 2.0, 3.5, 3.9, 3.95, 4.05, 4.1, 4.5, 8.0, 20.0}) {
    const double expected = density(z) * config.resolution_m;
    EXPECT_NEAR(Probability(model, z, {static_cast<float>(r), Ending::kWall}), expected,
                0.03 * expected)
        << z;
  }
  EXPECT_NEAR(Probability(model, config.max_range_m, {4.0f, Ending::kWall}),
              config.max_weight + config.random_weight / model.bins(), 1e-5);
  EXPECT_EQ(Probability(model, 1000.0, {4.0f, Ending::kWall}),
            Probability(model, config.max_range_m, {4.0f, Ending::kWall}));
}

TEST(BeamModel, TheUnknownSaysNothingAboutWhatLiesBehindIt) {
  const BeamModelConfig config;
  const BeamModel model(config);
  const Return unknown{4.0f, Ending::kUnknown};
  const double behind = Probability(model, 5.0, unknown);
  EXPECT_NEAR(Probability(model, 25.0, unknown), behind, 1e-9);
  EXPECT_GT(behind, Probability(model, 3.5, unknown));
  // A wall at the right place is better than ignorance, one at a wrong place worse.
  EXPECT_GT(Probability(model, 5.0, {5.0f, Ending::kWall}), 10.0 * behind);
  EXPECT_LT(Probability(model, 5.0, {4.0f, Ending::kWall}), 0.5 * behind);
}

}  // namespace
}  // namespace soundmap::localization
