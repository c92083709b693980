#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "soundmap/poses.h"

namespace soundmap {

// Ids are the last parts of resource names: the site "sites/hall" has the id "hall".

// One building with one shared map.
struct Site {
  std::string id;
  std::string profile;  // "default" or "paper"
  std::int64_t create_time_ns = 0;
  std::int64_t building_version = 0;  // of the geometric map; 0: none yet
  std::string parameters_toml;        // the parameters in force, with units
  double voxel_size_m = 0.0;
  double max_range_m = 0.0;  // R_max
};

enum class Purpose { kUnknown, kListening, kMapping };
enum class SessionState { kUnknown, kOpen, kComplete, kFailed };

// Frames that a robot recorded and lost before they could be sent.
struct FrameGap {
  std::int64_t offset = 0;  // in the session, in their place
  std::int64_t frames = 0;
  std::int64_t from_ns = 0;  // capture time of the frame before; 0: not known
  std::int64_t to_ns = 0;    // of the frame behind; 0: not known
  std::string reason;
};

// One drive of one robot at one site.
struct Session {
  std::string id;
  std::string site;
  std::string robot;
  Purpose purpose = Purpose::kUnknown;
  SessionState state = SessionState::kUnknown;
  std::string error_message;  // of a failed session
  std::vector<std::string> warnings;
  // Frames that were received, are on the server's disk, have had their effect.
  std::int64_t received = 0;
  std::int64_t durable = 0;
  std::int64_t processed = 0;
  std::int64_t create_time_ns = 0;
  std::int64_t first_frame_time_ns = 0;
  std::int64_t last_frame_time_ns = 0;
  std::int64_t building_version = 0;
  std::int64_t audio_scans = 0;  // that entered the map
  std::vector<FrameGap> gaps;    // in order
};

// A robot that has had a session; its last known whereabouts.
struct Robot {
  std::string id;
  std::string site;     // of its newest session
  std::string session;  // its newest session
  bool streaming = false;
  std::optional<PoseEstimate> pose;
  std::int64_t last_seen_ns = 0;  // server time
  std::int64_t lost_frames = 0;   // in that session, before they could be sent
};

// Long-running work on the server.
struct Operation {
  std::string id;
  std::string kind;  // "build_map", "import_map", "backup"
  std::string site;
  bool done = false;
  double progress = 0.0;  // 0 .. 1
  std::string progress_text;
  int error_code = 0;  // an absl::StatusCode; 0 while running and on success
  std::string error_message;
  std::int64_t create_time_ns = 0;
  std::int64_t end_time_ns = 0;
  std::string report_json;  // figures of the finished work
};

}  // namespace soundmap
