#include "convert.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace soundmap::internal {
namespace {

std::string Name(std::string_view collection, const std::string& id) {
  const absl::string_view prefix(collection.data(), collection.size());
  return absl::StartsWith(id, prefix) ? id : absl::StrCat(prefix, id);
}

Vector3 FromProto(const v1::Vector3& wire) { return {wire.x(), wire.y(), wire.z()}; }

Pose2 FromProto(const v1::Pose2& wire) { return {wire.x_m(), wire.y_m(), wire.yaw_rad()}; }

LocalizationState FromProto(v1::LocalizationState wire) {
  switch (wire) {
    case v1::LOCALIZATION_STATE_TRACKING:
      return LocalizationState::kTracking;
    case v1::LOCALIZATION_STATE_UNCERTAIN:
      return LocalizationState::kUncertain;
    case v1::LOCALIZATION_STATE_LOST:
      return LocalizationState::kLost;
    default:
      return LocalizationState::kUnknown;
  }
}

Purpose FromProto(v1::Purpose wire) {
  switch (wire) {
    case v1::PURPOSE_LISTENING:
      return Purpose::kListening;
    case v1::PURPOSE_MAPPING:
      return Purpose::kMapping;
    default:
      return Purpose::kUnknown;
  }
}

SessionState FromProto(v1::SessionState wire) {
  switch (wire) {
    case v1::SESSION_STATE_OPEN:
      return SessionState::kOpen;
    case v1::SESSION_STATE_COMPLETE:
      return SessionState::kComplete;
    case v1::SESSION_STATE_FAILED:
      return SessionState::kFailed;
    default:
      return SessionState::kUnknown;
  }
}

SoundSourceState FromProto(v1::SoundSourceState wire) {
  switch (wire) {
    case v1::SOUND_SOURCE_STATE_ACTIVE:
      return SoundSourceState::kActive;
    case v1::SOUND_SOURCE_STATE_SILENT:
      return SoundSourceState::kSilent;
    case v1::SOUND_SOURCE_STATE_GONE:
      return SoundSourceState::kGone;
    default:
      return SoundSourceState::kUnknown;
  }
}

SoundSourceEvent::Kind FromProto(v1::SoundSourceEvent::Kind wire) {
  using Kind = SoundSourceEvent::Kind;
  switch (wire) {
    case v1::SoundSourceEvent::KIND_APPEARED:
      return Kind::kAppeared;
    case v1::SoundSourceEvent::KIND_FELL_SILENT:
      return Kind::kFellSilent;
    case v1::SoundSourceEvent::KIND_ACTIVE_AGAIN:
      return Kind::kActiveAgain;
    case v1::SoundSourceEvent::KIND_VANISHED:
      return Kind::kVanished;
    case v1::SoundSourceEvent::KIND_MERGED:
      return Kind::kMerged;
    case v1::SoundSourceEvent::KIND_MOVED:
      return Kind::kMoved;
    default:
      return Kind::kUnknown;
  }
}

}  // namespace

std::string SiteName(const std::string& site) { return Name("sites/", site); }

std::string SessionName(const std::string& site, const std::string& session) {
  if (absl::StartsWith(session, "sites/")) return session;
  return absl::StrCat(SiteName(site), "/sessions/", session);
}

std::string SourceName(const std::string& site, const std::string& source) {
  if (absl::StartsWith(source, "sites/")) return source;
  return absl::StrCat(SiteName(site), "/soundSources/", source);
}

std::string RobotName(const std::string& robot) { return Name("robots/", robot); }

std::string OperationName(const std::string& operation) { return Name("operations/", operation); }

std::string IdIn(const std::string& name, std::string_view collection) {
  const std::vector<std::string> parts = absl::StrSplit(name, '/');
  for (std::size_t i = 0; i + 1 < parts.size(); i += 2) {
    if (parts[i] == collection) return parts[i + 1];
  }
  return "";
}

Site FromProto(const v1::Site& wire) {
  Site site{.id = IdIn(wire.name(), "sites"),
            .profile = wire.profile(),
            .create_time_ns = wire.create_time_ns(),
            .building_version = wire.building_version(),
            .parameters_toml = wire.parameters_toml(),
            .voxel_size_m = wire.voxel_size_m(),
            .max_range_m = wire.max_range_m(),
            .keep_frames_s = wire.keep_frames_s()};
  for (const v1::Band& band : wire.bands()) {
    site.bands.push_back({band.name(), band.min_frequency_hz(), band.max_frequency_hz()});
  }
  return site;
}

namespace {

ClockOffset FromProto(const v1::ClockOffset& wire) {
  return {.server_minus_robot_ns = wire.server_minus_robot_ns(),
          .uncertainty_ns = wire.uncertainty_ns(),
          .time_ns = wire.time_ns(),
          .drift_ppm = wire.drift_ppm()};
}

LiveView FromProto(const v1::LiveView& wire) {
  LiveView view{.session = IdIn(wire.session(), "sessions"),
                .age_ns = wire.age_ns(),
                .recording = wire.drive_state() == v1::DRIVE_STATE_RECORDING,
                .recorded_frames = wire.recorded_frames(),
                .odometry_time_ns = wire.odometry_time_ns(),
                .localized_time_ns = wire.localized_time_ns()};
  if (wire.has_odom_from_base()) view.odom_from_base = FromProto(wire.odom_from_base());
  if (wire.has_map_from_base()) view.map_from_base = FromProto(wire.map_from_base());
  if (wire.has_laser()) {
    const v1::LaserView& laser = wire.laser();
    view.laser = LaserView{laser.time_ns(),
                           laser.start_angle_rad(),
                           laser.angle_increment_rad(),
                           {laser.range_m().begin(), laser.range_m().end()}};
  }
  return view;
}

}  // namespace

Session FromProto(const v1::Session& wire) {
  std::vector<ClockOffset> clock_offsets;
  for (const v1::ClockOffset& offset : wire.clock_offsets()) {
    clock_offsets.push_back(FromProto(offset));
  }
  std::vector<FrameGap> gaps;
  for (const v1::FrameGap& gap : wire.gaps()) {
    gaps.push_back({gap.offset(), gap.frames(), gap.from_ns(), gap.to_ns(), gap.reason()});
  }
  return {.id = IdIn(wire.name(), "sessions"),
          .site = IdIn(wire.name(), "sites"),
          .robot = IdIn(wire.robot(), "robots"),
          .purpose = FromProto(wire.purpose()),
          .state = FromProto(wire.state()),
          .error_message = wire.error_message(),
          .warnings = {wire.warnings().begin(), wire.warnings().end()},
          .received = wire.received(),
          .durable = wire.durable(),
          .processed = wire.processed(),
          .create_time_ns = wire.create_time_ns(),
          .first_frame_time_ns = wire.first_frame_time_ns(),
          .last_frame_time_ns = wire.last_frame_time_ns(),
          .building_version = wire.building_version(),
          .audio_scans = wire.audio_scans(),
          .gaps = std::move(gaps),
          .clock_offsets = std::move(clock_offsets),
          .frames_dropped = wire.frames_dropped()};
}

Robot FromProto(const v1::Robot& wire) {
  Robot robot{.id = IdIn(wire.name(), "robots"),
              .site = IdIn(wire.site(), "sites"),
              .session = IdIn(wire.session(), "sessions"),
              .streaming = wire.streaming(),
              .last_seen_ns = wire.last_seen_ns(),
              .lost_frames = wire.lost_frames()};
  if (wire.has_pose()) robot.pose = FromProto(wire.pose());
  if (wire.has_live()) robot.live = FromProto(wire.live());
  if (wire.has_clock_offset()) robot.clock_offset = FromProto(wire.clock_offset());
  return robot;
}

Operation FromProto(const v1::Operation& wire) {
  return {.id = IdIn(wire.name(), "operations"),
          .kind = wire.kind(),
          .site = IdIn(wire.site(), "sites"),
          .done = wire.done(),
          .progress = wire.progress(),
          .progress_text = wire.progress_text(),
          .error_code = wire.error_code(),
          .error_message = wire.error_message(),
          .create_time_ns = wire.create_time_ns(),
          .end_time_ns = wire.end_time_ns(),
          .report_json = wire.report_json()};
}

PoseEstimate FromProto(const v1::PoseEstimate& wire) {
  PoseEstimate pose{.time_ns = wire.time_ns(),
                    .map_from_base = FromProto(wire.map_from_base()),
                    .effective_particles = wire.effective_particles(),
                    .state = FromProto(wire.state())};
  if (wire.covariance_size() == 9) {
    std::copy(wire.covariance().begin(), wire.covariance().end(),
              pose.covariance.emplace().begin());
  }
  return pose;
}

SoundSource FromProto(const v1::SoundSource& wire) {
  SoundSource source{.id = IdIn(wire.name(), "soundSources"),
                     .site = IdIn(wire.name(), "sites"),
                     .position_in_map_m = FromProto(wire.position_m()),
                     .extent_m = wire.extent_m(),
                     .probability = wire.probability(),
                     .evidence_count = wire.evidence_count(),
                     .first_heard_ns = wire.first_heard_ns(),
                     .last_heard_ns = wire.last_heard_ns(),
                     .peak_log_odds = wire.peak_log_odds(),
                     .voxel_count = wire.voxel_count(),
                     .state = FromProto(wire.state()),
                     .view_point_count = wire.view_point_count(),
                     .last_listened_ns = wire.last_listened_ns()};
  if (wire.position_covariance_m2_size() == 9) {
    std::copy(wire.position_covariance_m2().begin(), wire.position_covariance_m2().end(),
              source.position_covariance_m2.emplace().begin());
  }
  for (const std::string& robot : wire.robots()) source.robots.push_back(IdIn(robot, "robots"));
  for (const auto& period : wire.heard_periods()) {
    source.heard_periods.push_back({period.start_ns(), period.end_ns()});
  }
  if (wire.has_level_db()) source.level_db = wire.level_db();
  if (wire.has_spl_db()) source.spl_db = wire.spl_db();
  for (const auto& band : wire.spectrum()) {
    OctaveBandLevel& level = source.spectrum.emplace_back();
    level.centre_hz = band.centre_hz();
    level.level_db = band.level_db();
    if (band.has_spl_db()) level.spl_db = band.spl_db();
  }
  if (wire.has_mirror_position_m()) source.mirror_in_map_m = FromProto(wire.mirror_position_m());
  if (!wire.explained_by().empty()) {
    source.explained_by = IdIn(wire.explained_by(), "soundSources");
  }
  source.band = wire.band();
  return source;
}

SoundSourceEvent FromProto(const v1::SoundSourceEvent& wire) {
  SoundSourceEvent event{.kind = FromProto(wire.kind()),
                         .time_ns = wire.time_ns(),
                         .source = FromProto(wire.sound_source()),
                         .other_id = IdIn(wire.other_sound_source(), "soundSources")};
  if (wire.has_from_m()) event.from_in_map_m = FromProto(wire.from_m());
  return event;
}

AudioScan FromProto(const v1::AudioScan& wire) {
  AudioScan scan{.session = IdIn(wire.session(), "sessions"),
                 .robot = IdIn(wire.robot(), "robots"),
                 .time_ns = wire.time_ns(),
                 .noise_floor = wire.noise_floor(),
                 .end_point_count = wire.end_point_count(),
                 .band = wire.band()};
  if (wire.has_pose()) scan.pose = FromProto(wire.pose());
  for (const auto& peak : wire.peaks()) {
    scan.peaks.push_back({peak.azimuth_rad(), peak.elevation_rad(), peak.power()});
  }
  return scan;
}

VoxelColumns FromProto(const v1::VoxelChunk& wire) {
  const auto size =
      std::min({wire.x_key_size(), wire.y_key_size(), wire.z_key_size(), wire.log_odds_size(),
                wire.update_count_size(), wire.last_update_ns_size()});
  const auto column = [size](const auto& values) {
    using Values = std::decay_t<decltype(values)>;
    return std::vector<typename Values::value_type>(values.begin(), values.begin() + size);
  };
  return {.revision = wire.revision(),
          .as_of_ns = wire.as_of_ns(),
          .voxel_size_m = wire.voxel_size_m(),
          .x_key = column(wire.x_key()),
          .y_key = column(wire.y_key()),
          .z_key = column(wire.z_key()),
          .log_odds = column(wire.log_odds()),
          .update_count = column(wire.update_count()),
          .last_update_ns = {wire.last_update_ns().begin(), wire.last_update_ns().begin() + size}};
}

WatchEvent FromProto(const v1::WatchEvent& wire) {
  WatchEvent event{.revision = wire.revision(), .resume_token = wire.resume_token()};
  switch (wire.event_case()) {
    case v1::WatchEvent::kSoundSource:
      event.event = FromProto(wire.sound_source());
      break;
    case v1::WatchEvent::kRemovedSoundSource:
      event.event = RemovedSoundSource{IdIn(wire.removed_sound_source(), "soundSources")};
      break;
    case v1::WatchEvent::kSoundSourceEvent:
      event.event = FromProto(wire.sound_source_event());
      break;
    case v1::WatchEvent::kRobot:
      event.event = FromProto(wire.robot());
      break;
    case v1::WatchEvent::kLiveRobot: {
      const v1::LiveRobot& from = wire.live_robot();
      LiveRobot live{.robot = IdIn(from.robot(), "robots")};
      if (from.has_live()) live.live = FromProto(from.live());
      if (from.has_clock_offset()) live.clock_offset = FromProto(from.clock_offset());
      event.event = std::move(live);
      break;
    }
    case v1::WatchEvent::kAudioScan:
      event.event = FromProto(wire.audio_scan());
      break;
    case v1::WatchEvent::kSnapshotComplete:
      event.event = SnapshotComplete{};
      break;
    case v1::WatchEvent::kResync:
      event.event = Resync{};
      break;
    // An event of a newer server says at least that the connection is alive.
    case v1::WatchEvent::kHeartbeat:
    case v1::WatchEvent::EVENT_NOT_SET:
      event.event = Heartbeat{};
      break;
  }
  return event;
}

void ToProto(const Pose2& pose, v1::Pose2& wire) {
  wire.set_x_m(pose.x_m);
  wire.set_y_m(pose.y_m);
  wire.set_yaw_rad(pose.yaw_rad);
}

void ToProto(const Vector3& vector, v1::Vector3& wire) {
  wire.set_x(vector.x);
  wire.set_y(vector.y);
  wire.set_z(vector.z);
}

v1::SoundSourceState ToProto(SoundSourceState state) {
  switch (state) {
    case SoundSourceState::kActive:
      return v1::SOUND_SOURCE_STATE_ACTIVE;
    case SoundSourceState::kSilent:
      return v1::SOUND_SOURCE_STATE_SILENT;
    case SoundSourceState::kGone:
      return v1::SOUND_SOURCE_STATE_GONE;
    case SoundSourceState::kUnknown:
      break;
  }
  return v1::SOUND_SOURCE_STATE_UNSPECIFIED;
}

v1::ExportWhat ToProto(ExportWhat what) {
  switch (what) {
    case ExportWhat::kSound:
      return v1::EXPORT_WHAT_SOUND;
    case ExportWhat::kGeometry:
      return v1::EXPORT_WHAT_GEOMETRY;
    case ExportWhat::kFloorPlan:
      return v1::EXPORT_WHAT_FLOOR_PLAN;
  }
  return v1::EXPORT_WHAT_UNSPECIFIED;
}

}  // namespace soundmap::internal
