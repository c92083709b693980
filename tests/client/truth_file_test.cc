#include "cli/truth_file.h"

#include <gtest/gtest.h>

#include <fstream>

#include "absl/strings/match.h"

namespace soundmap::cli {
namespace {

std::string WriteFile(const std::string& text) {
  const std::string path = ::testing::TempDir() + "scene.truth.json";
  std::ofstream(path, std::ios::binary) << text;
  return path;
}

TEST(ReadTruthFile, ReadsAScene) {
  const auto truth = ReadTruthFile(WriteFile(R"({
    "frame": "map", "start_pose": [1, 2, 0.5], "room": [10, 7, 2.7],
    "obstacles": [[[3, 4.5, 0], [6, 2, 0.75]]],
    "sources": [{"position": [2, 1.6, 2.7], "extent_m": 0.5, "kind": "fan", "level": 0.5},
                {"position": [1, 1, 1], "on_s": 3, "off_s": 20.5}]})"));
  ASSERT_TRUE(truth.ok()) << truth.status();
  ASSERT_EQ(truth->sources.size(), 2u);
  EXPECT_EQ(truth->sources[0].position_in_map_m.y, 1.6);
  EXPECT_EQ(truth->sources[0].extent_m, 0.5);
  EXPECT_EQ(truth->sources[0].level, 0.5);
  EXPECT_EQ(truth->sources[0].kind, "fan");
  EXPECT_FALSE(truth->sources[0].on_s.has_value());
  EXPECT_EQ(truth->sources[1].on_s, 3.0);
  EXPECT_EQ(truth->sources[1].off_s, 20.5);
  EXPECT_EQ(truth->room_size_m->z, 2.7);
  ASSERT_EQ(truth->obstacles.size(), 1u);
  // Corners in any order.
  EXPECT_EQ(truth->obstacles[0].min_m.y, 2.0);
  EXPECT_EQ(truth->obstacles[0].max_m.y, 4.5);
}

TEST(ReadTruthFile, NamesWhatItRefuses) {
  const std::pair<const char*, const char*> cases[] = {
      {"", "not a JSON object"},
      {"[1, 2]", "not a JSON object"},
      {"{\"sources\": [", "not a JSON object"},
      {"{}", "no list of sources"},
      {"{\"sources\": 3}", "no list of sources"},
      {"{\"sources\": [], \"frame\": \"odom\"}", "frame"},
      {"{\"sources\": [{}]}", "source 0"},
      {"{\"sources\": [7]}", "source 0"},
      {"{\"sources\": [{\"position\": [1, 2]}]}", "source 0"},
      {"{\"sources\": [{\"position\": [1, 2, \"3\"]}]}", "source 0"},
      {"{\"sources\": [{\"position\": [1, 2, 3], \"on_s\": \"soon\"}]}", "source 0"},
      {"{\"sources\": [{\"position\": [1e999, 2, 3]}]}", "not a JSON object"},
      {"{\"sources\": [], \"room\": [1, 2]}", "room"},
      {"{\"sources\": [], \"obstacles\": [[1, 2]]}", "obstacle 0"},
      {"{\"sources\": [], \"obstacles\": 1}", "obstacles"},
  };
  for (const auto& [text, sentence] : cases) {
    const auto truth = ReadTruthFile(WriteFile(text));
    ASSERT_FALSE(truth.ok()) << text;
    EXPECT_TRUE(absl::StrContains(truth.status().message(), sentence))
        << text << " gave " << truth.status();
    EXPECT_TRUE(absl::StrContains(truth.status().message(), "scene.truth.json"));
  }
}

}  // namespace
}  // namespace soundmap::cli
