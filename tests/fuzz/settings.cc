#include "config.h"
#include "pipeline/profile.h"
#include "run_config.h"
#include "sources/simulation/scene.h"
#include "tests/fuzz/target.h"
#include "tests/fuzz/temporary_folder.h"

namespace soundmap::fuzz {

// The first byte is the kind: a profile, the server's settings, the robot's, a scene.
std::vector<std::string> Seeds() {
  std::vector<std::string> seeds = {
      "\1data_dir = \"d\"\nthreads = 4\ninsecure = true\nmax_calls_per_s = 10.0\n"
      "[profiles.quiet.sound_map]\nvoxel_size_m = 0.1\n[profiles.default.fusion]\npose_wait_s = "
      "1\n",
      "\2[server]\naddress = \"localhost:7443\"\n[robot]\nname = \"r1\"\nsite = \"hall\"\n"
      "initial_x_m = 1\ninitial_y_m = 2.5\ninitial_yaw_deg = -90\n[source]\ndrive = \"a.mcap\"\n"
      "[spool]\ndir = \"spool\"\nmax_gb = 0.5\nwhen_full = \"drop_oldest\"\n[uplink]\nlive = "
      "true\n",
      "\3{\"room_m\": [9, 6, 3.2], \"reverberation\": {\"rt60_s\": 0.6, \"image_order\": 2},"
      " \"furniture\": [[[3.4, 2.4, 0], [5.6, 3.6, 1.0]]],"
      " \"sources\": [{\"kind\": \"hiss\", \"position\": [6.0, 0.0, 1.4], \"on_s\": 20}],"
      " \"array\": {\"position_m\": [0.1, 0, 1.2], \"shape\": \"dome\", \"radius_m\": 0.15},"
      " \"path\": {\"way_points\": [[2.2, 1.5], [4.5, 1.4], [6.8, 1.5]], \"speed_mps\": 0.6},"
      " \"seed\": 4}"};
  for (const char* name : {"default", "paper"}) {
    seeds.push_back('\0' + ToToml(*pipeline::ProfileByName(name)));
  }
  return seeds;
}

void Decode(std::string_view bytes) {
  if (bytes.empty()) return;
  static const TemporaryFolder folder;
  const std::string path = (folder.path() / "settings").string();
  const int kind = static_cast<unsigned char>(bytes[0]) % 4;
  bytes.remove_prefix(1);
  if (kind == 1 || kind == 2) WriteFile(path, bytes);
  if (kind == 0) {
    const auto profile = pipeline::ProfileFromToml(std::string(bytes));
    if (!profile.ok()) return;
    // A site keeps its parameters so.
    Require(profile->Validate().ok());
    const std::string toml = ToToml(*profile);
    const auto again = pipeline::ProfileFromToml(toml);
    Require(again.ok() && ToToml(*again) == toml);
  } else if (kind == 1) {
    ServerConfig config = DefaultServerConfig();
    if (config.ReadFile(path).ok()) (void)config.Validate();
  } else if (kind == 2) {
    const auto config = RunConfig::Read(path);
    if (config.ok()) Require(config->spool.Validate().ok() && !config->session.robot.empty());
  } else {
    (void)simulation::ParseScene(std::string(bytes), "scene", folder.path().string());
  }
}

}  // namespace soundmap::fuzz
