#include "localization/config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

namespace soundmap::localization {
namespace {

TEST(Config, BothProfilesAreValidAndThePapersIsThePlainFilter) {
  EXPECT_TRUE(DefaultConfig().Validate().ok());
  EXPECT_TRUE(PaperConfig().Validate().ok());
  EXPECT_EQ(PaperConfig().particles, 200);
  EXPECT_DOUBLE_EQ(PaperConfig().correction_distance_m, 0.1);
  EXPECT_DOUBLE_EQ(PaperConfig().correction_turn_rad, 5.0 * geometry::kPi / 180.0);
  EXPECT_FALSE(PaperConfig().refinement.enabled);
}

TEST(Config, NamesTheParameterAtFault) {
  const auto message = [](auto change) {
    Config config;
    change(config);
    return std::string(config.Validate().message());
  };
  EXPECT_THAT(message([](Config& c) { c.particles = 0; }), testing::HasSubstr("particles"));
  EXPECT_THAT(message([](Config& c) { c.tempering = 0.0; }), testing::HasSubstr("tempering"));
  EXPECT_THAT(message([](Config& c) { c.laser_lag_s = std::numeric_limits<double>::quiet_NaN(); }),
              testing::HasSubstr("laser_lag_s"));
  EXPECT_THAT(message([](Config& c) { c.beam_model.hit_weight = 0.5; }),
              testing::HasSubstr("add up to"));
  EXPECT_THAT(message([](Config& c) { c.beam_model.max_range_m = 1e9; }),
              testing::HasSubstr("max_range_m"));
  EXPECT_THAT(message([](Config& c) { c.health.tracking_fit = 0.1; }),
              testing::HasSubstr("tracking_fit"));
}

}  // namespace
}  // namespace soundmap::localization
