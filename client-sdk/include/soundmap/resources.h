#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "soundmap/poses.h"

namespace soundmap {

// Ids are the last parts of resource names: the site "sites/hall" has the id "hall".

// A range of frequencies of which a site has a sound map of its own.
struct Band {
  std::string name;
  double min_frequency_hz = 0.0;  // both inclusive
  double max_frequency_hz = 0.0;
};

// One building with one shared map.
struct Site {
  std::string id;
  std::string profile;  // "default" or "paper"
  std::int64_t create_time_ns = 0;
  std::int64_t building_version = 0;  // of the geometric map; 0: none yet
  std::string parameters_toml;        // the parameters in force, with units
  double voxel_size_m = 0.0;
  double max_range_m = 0.0;  // R_max
  // How long the frames of a listening drive are kept from when it was begun; 0: for ever.
  std::int64_t keep_frames_s = 0;
  std::vector<Band> bands;  // beside that of its profile
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

// By how much the server's clock differs from a robot's, which capture times are of.
struct ClockOffset {
  std::int64_t server_minus_robot_ns = 0;  // to be added to a time of the robot's clock
  std::int64_t uncertainty_ns = 0;         // at `time_ns` the offset is off by no more
  std::int64_t time_ns = 0;                // server's clock
  double drift_ppm = 0.0;                  // by which the uncertainty grows later

  std::int64_t UncertaintyAt(std::int64_t server_time_ns) const {
    const double age_ns = std::abs(static_cast<double>(server_time_ns - time_ns));
    return uncertainty_ns + static_cast<std::int64_t>(std::ceil(1e-6 * drift_ppm * age_ns));
  }
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
  // The newest, and before it the last ones before each jump of a clock. None in a replay.
  std::vector<ClockOffset> clock_offsets;
  bool frames_dropped = false;  // the site keeps them no longer
};

// A thinned scan of the LRF, for the eye.
struct LaserView {
  std::int64_t time_ns = 0;  // capture time of the first beam
  double start_angle_rad = 0.0;
  double angle_increment_rad = 0.0;
  std::vector<float> range_m;  // 0: no return
};

// What a robot said of itself last, beside the frames that wait on it.
struct LiveView {
  std::string session;      // of the drive at hand; the server need not have it yet
  std::int64_t age_ns = 0;  // when it was told
  bool recording = false;   // else the drive is over
  std::int64_t recorded_frames = 0;
  std::int64_t odometry_time_ns = 0;  // capture time
  std::optional<Pose2> odom_from_base;
  // Where the newest localized frame had the robot, carried on by the odometry since; none while it
  // is lost.
  std::optional<Pose2> map_from_base;
  std::int64_t localized_time_ns = 0;  // capture time of that frame
  std::optional<LaserView> laser;
};

// A robot that has had a session or is live; its last known whereabouts.
struct Robot {
  std::string id;
  std::string site;     // of its newest session
  std::string session;  // its newest session
  bool streaming = false;
  std::optional<PoseEstimate> pose;
  std::int64_t last_seen_ns = 0;  // server time
  std::int64_t lost_frames = 0;   // in that session, before they could be sent
  std::optional<LiveView> live;
  std::optional<ClockOffset> clock_offset;  // none: it was never live, as in a replay
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
