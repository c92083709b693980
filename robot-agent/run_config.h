#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "server_files.h"
#include "spool/spool.h"
#include "uplink/drive_session.h"

namespace soundmap {

// What `soundmap-robot run` does, from a TOML file; docs/agent.md describes it.
struct RunConfig {
  ServerFiles server;
  uplink::DriveSession session;

  std::string drive;   // the recording that is played as if it were the robot's sensors
  double speed = 1.0;  // times real time; 0: as fast as the spool takes it
  double lidar_resolution_m = 0.001;
  bool coded = true;
  bool live = true;  // shows what the robot does while its frames wait

  std::string spool_folder;
  spool::SpoolOptions spool;

  // InvalidArgument: a key that is unknown, missing or out of its range, named.
  static absl::StatusOr<RunConfig> Read(const std::string& path);
};

}  // namespace soundmap
