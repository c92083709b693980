#pragma once

#include <optional>
#include <string>
#include <vector>

#include "soundmap/v1/session_service.pb.h"
#include "sources/replay/replay.h"

namespace soundmap::uplink {

// Whose drive it is and where.
struct DriveSession {
  std::string site;
  std::string robot;
  std::string purpose = "listening";  // or "mapping"
  std::vector<double> initial_pose;   // x_m, y_m, yaw_rad in the map; empty: unknown
  double laser_time_increment_s = 0.0;
  // Of the sine that just reaches full scale at the microphones, re 20 uPa; none: not known.
  std::optional<double> full_scale_spl_db;
};

// The session that a recorded drive makes: the same drive, the same session.
v1::CreateSessionRequest SessionRequest(const DriveSession& session, const sources::Replay& replay);

}  // namespace soundmap::uplink
