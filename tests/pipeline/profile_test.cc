#include "pipeline/profile.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace soundmap::pipeline {
namespace {

using ::testing::HasSubstr;

TEST(Profile, TheTwoProfilesAreValidAndTheirTextGivesThemBack) {
  for (const char* name : {"default", "paper"}) {
    const auto profile = ProfileByName(name);
    ASSERT_TRUE(profile.ok());
    EXPECT_TRUE(profile->Validate().ok()) << profile->Validate();
    const std::string text = ToToml(*profile);
    const auto read = ProfileFromToml(text);
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(ToToml(*read), text);
  }
  EXPECT_FALSE(ProfileByName("other").ok());
}

TEST(Profile, ThePaperHasThePapersNumbers) {
  const auto paper = ProfileByName("paper");
  const auto& sector = std::get<acoustics::SectorGrid>(paper->acoustics.grid);
  EXPECT_NEAR(geometry::DegFromRad(sector.elevation_max_rad), 75.0, 1e-9);
  EXPECT_EQ(std::get<acoustics::DoubleThreshold>(paper->acoustics.evidence).t2, 30.0);
  EXPECT_EQ(paper->acoustics.MakeGrid().size(), 4636);
  EXPECT_EQ(paper->localization.particles, 200);
  EXPECT_EQ(paper->ray_casting.max_range_m, 6.0);
  EXPECT_EQ(paper->sound_map.stop_rule, sound_map::StopRule::kFreeze);
  EXPECT_EQ(paper->sound_map.max_log_odds, 40.0);
}

TEST(Profile, AParameterIsTakenFromTheText) {
  const auto profile = ProfileFromToml(
      "profile = 'paper'\n[acoustics]\nt1 = 8.0\nt2 = 10\ngrid_step_deg = 3\n[ray_casting]\n"
      "shared_voxel = 'once'\n");
  ASSERT_TRUE(profile.ok()) << profile.status();
  EXPECT_EQ(std::get<acoustics::DoubleThreshold>(profile->acoustics.evidence).t1, 8.0);
  EXPECT_EQ(std::get<acoustics::DoubleThreshold>(profile->acoustics.evidence).t2, 10.0);
  EXPECT_EQ(profile->ray_casting.shared_voxel, ray_casting::SharedVoxel::kOnce);
  EXPECT_LT(profile->acoustics.MakeGrid().size(), 600);
}

TEST(Profile, HasTheBaselinesToCompareWith) {
  const auto profile = ProfileFromToml(
      "[acoustics]\nevidence = 'scaled_power'\np_max = 0.8\n[ray_casting]\nrange = 'map'\n");
  ASSERT_TRUE(profile.ok()) << profile.status();
  EXPECT_EQ(std::get<acoustics::ScaledPower>(profile->acoustics.evidence).p_max, 0.8);
  EXPECT_EQ(profile->ray_casting.range, ray_casting::RangeSource::kMap);
  const auto again = ProfileFromToml(ToToml(*profile));
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->acoustics, profile->acoustics);
  EXPECT_EQ(again->ray_casting.range, profile->ray_casting.range);
}

TEST(Profile, WhatIsWrongIsNamed) {
  const std::pair<const char*, const char*> cases[] = {
      {"profile = 'loud'", "loud"},
      {"[acoustics]\nf_mni_hz = 10.0", "acoustics.f_mni_hz"},
      {"[acoustics]\nf_min_hz = 'low'", "acoustics.f_min_hz"},
      {"[acoustics]\nf_min_hz = true", "acoustics.f_min_hz"},
      {"[sound_map]\njudge_by_views = 1", "sound_map.judge_by_views"},
      {"[localization]\nparticles = 1e99", "localization.particles"},
      {"[localization]\nparticles = 99999999999", "localization.particles"},
      {"[sound_map]\nstop_rule = 'never'", "sound_map.stop_rule"},
      {"[fusion]\npose_wait_s = -1", "fusion.pose_wait_s"},
      {"[sound_map]\nvoxel_size_m = 0.1", "voxel_size_m"},
      {"[acoustics]\nevidence = 'louder'", "acoustics.evidence"},
      {"[ray_casting]\nrange = 'far'", "ray_casting.range"},
      {"[acoustics", "TOML"},
      {"[=]", "TOML"}};
  for (const auto& [text, says] : cases) {
    const auto profile = ProfileFromToml(text);
    ASSERT_FALSE(profile.ok()) << text;
    EXPECT_THAT(std::string(profile.status().message()), HasSubstr(says)) << text;
  }
}

}  // namespace
}  // namespace soundmap::pipeline
