#include "tests/simulation/scene_texts.h"

#include <gtest/gtest.h>

#include <filesystem>

namespace soundmap::simulation {

nlohmann::json StandingScene() {
  return nlohmann::json::parse(R"({
    "room_m": [8, 7, 3],
    "sources": [{"kind": "white", "position": [5, 4, 1.5], "level": 1}],
    "array": {"position_m": [0, 0, 1.2], "microphones_m": [[0, 0, 0]]},
    "audio": {"sensor_noise": 0},
    "path": {"way_points": [[3, 3]], "standing_s": 10}
  })");
}

Scene Parse(const nlohmann::json& scene) {
  auto parsed = ParseScene(scene.dump(), "test.json", "");
  EXPECT_TRUE(parsed.ok()) << parsed.status();
  return *parsed;
}

std::string ErrorOf(const std::string& text) {
  const auto parsed = ParseScene(text, "test.json", "");
  return parsed.ok() ? "" : std::string(parsed.status().message());
}

std::string FreshFolder() {
  const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
  const auto folder = std::filesystem::path(::testing::TempDir()) /
                      (std::string("simulation_") + test->test_suite_name() + "_" + test->name());
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  return folder.string();
}

}  // namespace soundmap::simulation
