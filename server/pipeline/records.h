#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/frames.h"
#include "pipeline/band.h"

namespace soundmap::pipeline {

// What the store keeps of a site, as JSON.
struct SiteRecord {
  std::string site;
  std::string profile;
  // The parameters of every stage as they were when the site was created, so that a session that is
  // read again gives the same map.
  std::string parameters_toml;
  std::int64_t create_time_ns = 0;
  std::int64_t building_version = 0;           // 0: no geometric map yet
  std::vector<std::string> building_sessions;  // the drives that it was made from
  std::string create_request_id;               // empty: the client gave none
  std::int64_t keep_frames_s = 0;              // of listening drives; 0: for ever
  std::vector<Band> bands;                     // with maps of their own
};

enum class Purpose { kListening, kMapping };

// Frames that the robot recorded and lost before they were sent.
struct Gap {
  std::int64_t offset = 0;  // of their record in the session
  std::int64_t frames = 0;
  // Log times of the frame before and the one behind; 0: not known.
  frames::TimeNs from_ns = 0;
  frames::TimeNs to_ns = 0;
  std::string reason;

  bool operator==(const Gap&) const = default;
};

// By how much the server's clock differs from the robot's, which frames' times are of.
struct ClockOffset {
  std::int64_t server_minus_robot_ns = 0;
  std::int64_t uncertainty_ns = 0;  // at time_ns the offset is off by no more
  frames::TimeNs time_ns = 0;       // server's clock
  double drift_ppm = 0.0;           // by which the uncertainty grows later

  std::int64_t UncertaintyAt(frames::TimeNs at_ns) const;
  bool operator==(const ClockOffset&) const = default;
};

// What the store keeps of a session, as JSON.
struct SessionRecord {
  std::string site;
  std::string session;
  std::string robot;
  Purpose purpose = Purpose::kListening;
  frames::Calibration calibration;
  std::optional<geometry::Pose2> initial_pose;
  std::vector<std::string> warnings;
  std::int64_t epoch = 0;
  std::int64_t create_time_ns = 0;
  std::int64_t building_version = 0;  // that the robot is localized in
  std::vector<Gap> gaps;              // in order
  std::vector<ClockOffset> clock_offsets;
  bool complete = false;
  // Final figures, once complete.
  std::int64_t frame_count = 0;
  frames::TimeNs first_frame_ns = 0;
  frames::TimeNs last_frame_ns = 0;
  std::int64_t audio_scans = 0;
  bool frames_dropped = false;  // the site does not keep them so long

  std::int64_t lost_frames() const;
  std::optional<ClockOffset> newest_offset() const;
  // The newest takes the place of the one before, unless a clock has jumped in between: they differ
  // by more than they can be off. Keeps 32; what comes later replaces the last. Whether one jumped.
  bool Take(const ClockOffset& newest);
};

std::string ToJson(const SiteRecord& record);
std::string ToJson(const SessionRecord& record);
// DataLoss: not such a record.
absl::StatusOr<SiteRecord> SiteRecordFromJson(const std::string& json);
absl::StatusOr<SessionRecord> SessionRecordFromJson(const std::string& json);

}  // namespace soundmap::pipeline
