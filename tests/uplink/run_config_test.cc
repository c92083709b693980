#include "run_config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <numbers>
#include <sstream>
#include <tuple>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"

namespace soundmap {
namespace {

using ::testing::HasSubstr;

// The example of docs/agent.md, which has every key.
std::string Example() {
  std::ifstream file(SOUNDMAP_SOURCE_DIR "/docs/agent.md");
  std::ostringstream text;
  text << file.rdbuf();
  const std::string page = text.str();
  const std::string fence = "```toml\n";
  const std::size_t begin = page.find(fence) + fence.size();
  return page.substr(begin, page.find("```", begin) - begin);
}

absl::StatusOr<RunConfig> Read(const std::string& text) {
  const std::string path = ::testing::TempDir() + "/agent.toml";
  std::ofstream(path) << text;
  return RunConfig::Read(path);
}

TEST(RunConfig, TheExampleOfTheDocumentation) {
  const auto config = Read(Example());
  ASSERT_TRUE(config.ok()) << config.status();
  EXPECT_EQ(config->server.address, "server.example:7443");
  EXPECT_EQ(config->server.token_file, "token");
  EXPECT_EQ(config->server.tls_ca, "ca.pem");
  EXPECT_EQ(config->server.tls_cert, "r1.pem");
  EXPECT_EQ(config->server.tls_key, "r1.key");
  EXPECT_EQ(config->session.robot, "r1");
  EXPECT_EQ(config->session.site, "hall");
  EXPECT_EQ(config->session.purpose, "listening");
  EXPECT_EQ(config->session.initial_pose, (std::vector{8.2, 4.2, 0.0}));
  EXPECT_EQ(config->session.laser_time_increment_s, 0.0);
  EXPECT_EQ(config->session.full_scale_spl_db, 120.0);
  EXPECT_EQ(config->drive, "drive.mcap");
  EXPECT_EQ(config->speed, 1.0);
  EXPECT_EQ(config->lidar_resolution_m, 0.001);
  EXPECT_EQ(config->spool_folder, "/var/lib/soundmap-robot");
  EXPECT_EQ(config->spool.max_bytes, 8'600'000'000);
  EXPECT_TRUE(config->spool.pause_when_full);
  EXPECT_EQ(config->spool.max_hours, 24.0);
  EXPECT_TRUE(config->coded);
  EXPECT_TRUE(config->live);
}

TEST(RunConfig, WhatIsNotGivenIsAsDocumented) {
  const auto config = Read(
      "[robot]\nname = 'r'\nsite = 's'\ninitial_x_m = 1\ninitial_y_m = -2.5\n"
      "initial_yaw_deg = -90\n[source]\ndrive = 'd'\n[spool]\ndir = 'f'\n");
  ASSERT_TRUE(config.ok()) << config.status();
  const auto documented = Read(Example());
  ASSERT_TRUE(documented.ok());
  EXPECT_EQ(config->server.address, "127.0.0.1:7443");
  EXPECT_EQ(config->server.tls_ca, "");
  EXPECT_EQ(config->session.purpose, "listening");
  EXPECT_FALSE(config->session.full_scale_spl_db);
  EXPECT_EQ(config->speed, documented->speed);
  EXPECT_EQ(config->lidar_resolution_m, documented->lidar_resolution_m);
  EXPECT_EQ(config->spool.pause_when_full, documented->spool.pause_when_full);
  EXPECT_NEAR(config->spool.max_bytes, documented->spool.max_bytes, 5e7);  // 8.6 is rounded
  EXPECT_EQ(config->coded, documented->coded);
  EXPECT_EQ(config->live, documented->live);
  EXPECT_EQ(config->session.initial_pose, (std::vector{1.0, -2.5, -0.5 * std::numbers::pi}));
}

TEST(RunConfig, AMistakeIsNamed) {
  const std::string example = Example();
  for (const auto& [from, to, said] :
       {std::tuple("name = \"r1\"", "", "robot.name"),
        {"site = \"hall\"", "", "robot.site"},
        {"drive = \"drive.mcap\"", "", "source.drive"},
        {"dir = \"/var/lib/soundmap-robot\"", "", "spool.dir"},
        {"purpose = \"listening\"", "purpose = \"dancing\"", "robot.purpose"},
        {"full_scale_spl_db = 120", "full_scale_spl_db = 1e3", "robot.full_scale_spl_db"},
        {"full_scale_spl_db = 120", "full_scale_spl = 120", "robot.full_scale_spl"},
        {"initial_y_m = 4.2", "", "given together"},
        {"initial_y_m = 4.2", "initial_y_m = nan", "robot.initial_y_m"},
        {"speed = 1 ", "speed = -1 ", "source.speed"},
        {"speed = 1 ", "speed = \"fast\" ", "source.speed"},
        {"max_gb = 8.6", "max_gb = 0", "agent.toml"},
        {"when_full = \"pause\"", "when_full = \"panic\"", "spool.when_full"},
        {"speed = 1 ", "speed = true ", "source.speed"},
        {"coded = true", "coded = 1", "uplink.coded"},
        {"coded = true", "coded = \"true\"", "uplink.coded"},
        {"[uplink]", "[uplinks]", "uplinks"},
        {"[uplink]", "[uplink", "agent.toml:"}}) {
    const std::string text = absl::StrReplaceAll(example, {{from, to}});
    ASSERT_NE(text, example) << from;
    const auto config = Read(text);
    EXPECT_EQ(config.status().code(), absl::StatusCode::kInvalidArgument) << to;
    EXPECT_THAT(std::string(config.status().message()), HasSubstr(said)) << to;
  }
  EXPECT_FALSE(RunConfig::Read(::testing::TempDir() + "/missing.toml").ok());
}

}  // namespace
}  // namespace soundmap
