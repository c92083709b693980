#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "sources/simulation/scene.h"
#include "sources/simulation/simulate.h"
#include "tests/simulation/scene_texts.h"

namespace soundmap::simulation {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

struct Wrong {
  const char* pointer;  // JSON pointer of the field to change
  nlohmann::json value;
  const char* named;  // the error names this
};

TEST(SceneJson, EveryErrorNamesFileAndField) {
  const Wrong wrongs[] = {
      {"/room_m", {8, 7}, "'room_m'"},
      {"/room_m", {8, 7, -3}, "'room_m'"},
      {"/room_m", "large", "'room_m'"},
      {"/room_m/0", 1e300, "'room_m'"},
      {"/rom_m", 1, "'rom_m'"},
      {"/seed", -1, "'seed'"},
      {"/furniture", {{{1, 1, 1}, {0, 2, 2}}}, "'furniture[0]'"},
      {"/furniture", {{{2.5, 2.5, 0}, {3.5, 3.5, 1}}}, "'path'"},
      {"/sources/0/kind", "trumpet", "'sources[0].kind'"},
      {"/sources/0/position", {5, 4, 9}, "'sources[0].position'"},
      {"/sources/0/level", nullptr, "'sources[0].level'"},
      {"/sources/0/levle", 1, "'sources[0].levle'"},
      {"/sources/0/on_s", -3, "'sources[0].on_s'"},
      {"/sources", 3, "'sources'"},
      {"/sources", nlohmann::json::array({7}), "'sources[0]'"},
      {"/people", {{{"way_points", nlohmann::json::array()}}}, "'people[0].way_points'"},
      {"/reverberation", {{"rt60_s", 0.001}}, "'reverberation.rt60_s'"},
      {"/reverberation", {{"rt60_s", 0.5}, {"absorption", 0.5}}, "'reverberation.rt60_s'"},
      {"/reverberation", {{"image_order", 1.5}}, "'reverberation.image_order'"},
      {"/reverberation", {{"image_order", 99}}, "'reverberation.image_order'"},
      {"/array/microphones_m", nlohmann::json::array(), "'array.microphones_m'"},
      {"/array/microphones_m/0", {0, 0}, "'array.microphones_m[0]'"},
      {"/array", {{"shape", "torus"}}, "'array.shape'"},
      {"/array/position_m", {0, 0, 5}, "'array.position_m'"},
      {"/audio/sample_rate_hz", 1e9, "'audio.sample_rate_hz'"},
      {"/audio/sensor_noise", "much", "'audio.sensor_noise'"},
      {"/audio", 5, "'audio'"},
      {"/lidar", {{"rings", 100000}}, "'lidar.rings'"},
      {"/lidar", {{"azimuth_step_deg", 0}}, "'lidar.azimuth_step_deg'"},
      {"/lidar", {{"elevations_deg", {5, 95}}}, "'lidar.elevations_deg'"},
      {"/lidar", {{"swept", 1}}, "'lidar.swept'"},
      {"/laser", {{"beams", 1}}, "'laser.beams'"},
      {"/laser", {{"rate_hz", 0}}, "'laser.rate_hz'"},
      {"/odometry", {{"rate_hz", 1e9}}, "'odometry.rate_hz'"},
      {"/path/way_points", nlohmann::json::array(), "'path.way_points'"},
      {"/path/way_points", {{1, 1}, {2, 2, 0}}, "'path.way_points[1]'"},
      {"/path/way_points", {{3, 3}, {20, 3}}, "'laser.position_m'"},
      {"/path/standing_s", 0, "'path'"},
      {"/path/laps", 1e9, "'path.laps'"},
  };
  ASSERT_EQ(ErrorOf(StandingScene().dump()), "");
  for (const Wrong& wrong : wrongs) {
    auto scene = StandingScene();
    scene[nlohmann::json::json_pointer(wrong.pointer)] = wrong.value;
    const std::string error = ErrorOf(scene.dump());
    EXPECT_THAT(error, AllOf(HasSubstr("test.json: "), HasSubstr(wrong.named))) << wrong.pointer;
    EXPECT_EQ(error.find('\n'), std::string::npos);
  }
}

TEST(SceneJson, WhatIsNotAnObjectOfJsonIsRefused) {
  for (const std::string& text :
       {std::string(), std::string("{"), std::string("[]"), std::string("null"),
        std::string("{\"room_m\": [NaN, 1, 1]}"), std::string("{\"room_m\": [1e999, 1, 1]}"),
        std::string("\xff\xfe\x00", 3), std::string(100000, '['),
        "{\"a\":" + std::string(1000, '[') + std::string(1000, ']') + "}"}) {
    EXPECT_THAT(ErrorOf(text), HasSubstr("test.json")) << text.substr(0, 20);
  }
}

// Every prefix and every scene with one byte changed either parses or gives a sentence.
TEST(SceneJson, DamagedTextsAreRefusedOrRead) {
  const std::string whole = StandingScene().dump();
  for (std::size_t length = 0; length < whole.size(); ++length) {
    EXPECT_THAT(ErrorOf(whole.substr(0, length)), HasSubstr("test.json"));
  }
  int refused = 0;
  for (std::size_t i = 0; i < whole.size(); ++i) {
    std::string damaged = whole;
    damaged[i] ^= 0x15;
    refused += !ErrorOf(damaged).empty();
  }
  EXPECT_GT(refused, static_cast<int>(whole.size() / 2));
}

TEST(SceneJson, EyringsFormulaGivesTheReflection) {
  auto text = StandingScene();
  text["room_m"] = {10, 7, 2.7};
  text["reverberation"] = {{"rt60_s", 0.35}};
  const double from_rt60 = Parse(text).reverberation.wall_reflection[3];
  const double alpha = 1 - std::exp(-0.161 * 189.0 / (231.8 * 0.35));
  EXPECT_NEAR(from_rt60, std::sqrt(1 - alpha), 1e-9);
  text["reverberation"] = {{"absorption", alpha}};
  const Scene again = Parse(text);
  EXPECT_NEAR(again.reverberation.rt60_s, 0.35, 1e-9);
  EXPECT_NEAR(again.reverberation.wall_reflection[3], from_rt60, 1e-9);
}

TEST(SceneJson, AudioMayBeSwitchedOffAndAMappingDriveHasNone) {
  auto text = StandingScene();
  EXPECT_TRUE(Parse(text).has_audio);
  const Scene listening = Parse(text), mapping = MappingDrive(listening);
  EXPECT_FALSE(mapping.has_audio);
  EXPECT_NE(mapping.seed, listening.seed);
  EXPECT_LT(mapping.start_time_ns, listening.start_time_ns);
  text["audio"] = false;
  EXPECT_FALSE(Parse(text).has_audio);
}

TEST(SceneJson, ShippedScenesLoad) {
  for (const char* name : {"grill_room", "office", "workshop", "leak"}) {
    const auto path = FindScene(name);
    ASSERT_TRUE(path.ok()) << path.status();
    const auto scene = LoadScene(*path);
    ASSERT_TRUE(scene.ok()) << scene.status();
    EXPECT_EQ(scene->array.microphone_in_array_m.size(), 16u);
  }
  EXPECT_THAT(std::string(FindScene("cellar").status().message()),
              AllOf(HasSubstr("cellar"), HasSubstr("grill_room, leak, office, workshop")));
  EXPECT_FALSE(FindScene("../scenes/office").ok());
  EXPECT_FALSE(FindScene("").ok());
  EXPECT_FALSE(LoadScene("/nonexistent/scene.json").ok());
}

}  // namespace
}  // namespace soundmap::simulation
