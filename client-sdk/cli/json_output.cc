#include "cli/json_output.h"

#include <charconv>
#include <cmath>
#include <numbers>

namespace soundmap::cli {
namespace {

constexpr double kDegPerRad = 180.0 / std::numbers::pi;

}  // namespace

double ShortestDecimal(float value) {
  if (!std::isfinite(value)) return value;
  char text[32];
  const auto end = std::to_chars(text, text + sizeof(text), value).ptr;
  double decimal = 0.0;
  std::from_chars(text, end, decimal);
  return decimal;
}

const char* NameOf(LocalizationState state) {
  switch (state) {
    case LocalizationState::kTracking:
      return "tracking";
    case LocalizationState::kUncertain:
      return "uncertain";
    case LocalizationState::kLost:
      return "lost";
    case LocalizationState::kUnknown:
      break;
  }
  return "unknown";
}

const char* NameOf(Purpose purpose) {
  switch (purpose) {
    case Purpose::kListening:
      return "listening";
    case Purpose::kMapping:
      return "mapping";
    case Purpose::kUnknown:
      break;
  }
  return "unknown";
}

const char* NameOf(SessionState state) {
  switch (state) {
    case SessionState::kOpen:
      return "open";
    case SessionState::kComplete:
      return "complete";
    case SessionState::kFailed:
      return "failed";
    case SessionState::kUnknown:
      break;
  }
  return "unknown";
}

const char* NameOf(SoundSourceState state) {
  switch (state) {
    case SoundSourceState::kActive:
      return "active";
    case SoundSourceState::kSilent:
      return "silent";
    case SoundSourceState::kGone:
      return "gone";
    case SoundSourceState::kUnknown:
      break;
  }
  return "unknown";
}

const char* NameOf(SoundSourceEvent::Kind kind) {
  using Kind = SoundSourceEvent::Kind;
  switch (kind) {
    case Kind::kAppeared:
      return "source_appeared";
    case Kind::kFellSilent:
      return "source_fell_silent";
    case Kind::kActiveAgain:
      return "source_active_again";
    case Kind::kVanished:
      return "source_vanished";
    case Kind::kMerged:
      return "source_merged";
    case Kind::kMoved:
      return "source_moved";
    case Kind::kUnknown:
      break;
  }
  return "source_event";
}

Json ToJson(const Vector3& vector) { return Json::array({vector.x, vector.y, vector.z}); }

Json ToJson(const Pose2& pose) {
  return {{"x_m", pose.x_m}, {"y_m", pose.y_m}, {"yaw_rad", pose.yaw_rad}};
}

Json ToJson(const Site& site) {
  Json json = {{"id", site.id},
               {"profile", site.profile},
               {"create_time_ns", site.create_time_ns},
               {"building_version", site.building_version},
               {"voxel_size_m", site.voxel_size_m},
               {"max_range_m", site.max_range_m},
               {"keep_frames_s", site.keep_frames_s},
               {"parameters_toml", site.parameters_toml}};
  for (const Band& band : site.bands) {
    json["bands"].push_back({{"name", band.name},
                             {"min_frequency_hz", band.min_frequency_hz},
                             {"max_frequency_hz", band.max_frequency_hz}});
  }
  return json;
}

Json ToJson(const Session& session) {
  Json gaps = Json::array();
  for (const FrameGap& gap : session.gaps) {
    gaps.push_back({{"offset", gap.offset},
                    {"frames", gap.frames},
                    {"from_ns", gap.from_ns},
                    {"to_ns", gap.to_ns},
                    {"reason", gap.reason}});
  }
  return {{"id", session.id},
          {"site", session.site},
          {"robot", session.robot},
          {"purpose", NameOf(session.purpose)},
          {"state", NameOf(session.state)},
          {"error", session.error_message},
          {"warnings", session.warnings},
          {"received", session.received},
          {"durable", session.durable},
          {"processed", session.processed},
          {"create_time_ns", session.create_time_ns},
          {"first_frame_time_ns", session.first_frame_time_ns},
          {"last_frame_time_ns", session.last_frame_time_ns},
          {"building_version", session.building_version},
          {"audio_scans", session.audio_scans},
          {"frames_dropped", session.frames_dropped},
          {"gaps", std::move(gaps)},
          {"clock_offsets", ListToJson("offsets", session.clock_offsets)["offsets"]}};
}

Json ToJson(const PoseEstimate& pose) {
  Json json = {{"time_ns", pose.time_ns},
               {"x_m", pose.map_from_base.x_m},
               {"y_m", pose.map_from_base.y_m},
               {"yaw_rad", pose.map_from_base.yaw_rad},
               {"state", NameOf(pose.state)}};
  if (pose.covariance) {
    json["covariance"] = *pose.covariance;
    json["effective_particles"] = pose.effective_particles;
  }
  return json;
}

Json ToJson(const Robot& robot) {
  return {{"id", robot.id},
          {"site", robot.site},
          {"session", robot.session},
          {"streaming", robot.streaming},
          {"last_seen_ns", robot.last_seen_ns},
          {"lost_frames", robot.lost_frames},
          {"pose", robot.pose ? ToJson(*robot.pose) : Json(nullptr)},
          {"live", robot.live ? ToJson(*robot.live) : Json(nullptr)},
          {"clock_offset", robot.clock_offset ? ToJson(*robot.clock_offset) : Json(nullptr)}};
}

Json ToJson(const ClockOffset& offset) {
  return {{"server_minus_robot_ns", offset.server_minus_robot_ns},
          {"uncertainty_ns", offset.uncertainty_ns},
          {"time_ns", offset.time_ns},
          {"drift_ppm", offset.drift_ppm}};
}

Json ToJson(const LiveView& live) {
  Json json = {{"session", live.session},
               {"age_ns", live.age_ns},
               {"recording", live.recording},
               {"recorded_frames", live.recorded_frames},
               {"odometry_time_ns", live.odometry_time_ns},
               {"odom_from_base", live.odom_from_base ? ToJson(*live.odom_from_base) : Json()},
               {"map_from_base", live.map_from_base ? ToJson(*live.map_from_base) : Json()},
               {"localized_time_ns", live.localized_time_ns}};
  if (live.laser) {
    Json ranges = Json::array();
    for (const float range_m : live.laser->range_m) ranges.push_back(ShortestDecimal(range_m));
    json["laser"] = {{"time_ns", live.laser->time_ns},
                     {"start_angle_rad", live.laser->start_angle_rad},
                     {"angle_increment_rad", live.laser->angle_increment_rad},
                     {"range_m", std::move(ranges)}};
  }
  return json;
}

Json ToJson(const Operation& operation) {
  Json json = {{"id", operation.id},
               {"kind", operation.kind},
               {"site", operation.site},
               {"done", operation.done},
               {"progress", operation.progress},
               {"progress_text", operation.progress_text},
               {"error_code", operation.error_code},
               {"error", operation.error_message},
               {"create_time_ns", operation.create_time_ns},
               {"end_time_ns", operation.end_time_ns}};
  const Json report =
      Json::parse(operation.report_json, /*cb=*/nullptr, /*allow_exceptions=*/false);
  json["report"] = report.is_discarded() ? Json(nullptr) : report;
  return json;
}

Json ToJson(const SoundSource& source) {
  Json json = {{"id", source.id},
               {"position_m", ToJson(source.position_in_map_m)},
               {"extent_m", source.extent_m},
               {"probability", source.probability},
               {"evidence_count", source.evidence_count},
               {"first_heard_ns", source.first_heard_ns},
               {"last_heard_ns", source.last_heard_ns},
               {"peak_log_odds", source.peak_log_odds},
               {"voxel_count", source.voxel_count},
               {"state", NameOf(source.state)}};
  if (source.position_covariance_m2) {
    json["position_covariance_m2"] = *source.position_covariance_m2;
  }
  json["view_point_count"] = source.view_point_count;
  json["robots"] = source.robots;
  json["last_listened_ns"] = source.last_listened_ns;
  if (!source.heard_periods.empty()) {
    Json& periods = json["heard_periods_ns"] = Json::array();
    for (const HeardPeriod& period : source.heard_periods) {
      periods.push_back({period.start_ns, period.end_ns});
    }
  }
  if (source.level_db) json["level_db"] = *source.level_db;
  if (source.spl_db) json["spl_db"] = *source.spl_db;
  if (!source.spectrum.empty()) {
    Json& spectrum = json["spectrum"] = Json::array();
    for (const OctaveBandLevel& band : source.spectrum) {
      Json level = {{"centre_hz", band.centre_hz}, {"level_db", band.level_db}};
      if (band.spl_db) level["spl_db"] = *band.spl_db;
      spectrum.push_back(std::move(level));
    }
  }
  if (source.mirror_in_map_m) json["mirror_position_m"] = ToJson(*source.mirror_in_map_m);
  if (!source.explained_by.empty()) json["explained_by"] = source.explained_by;
  if (!source.band.empty()) json["band"] = source.band;
  return json;
}

Json ToJson(const SoundSourceList& list, const std::string& site) {
  Json json = {{"site", site}, {"revision", list.revision}, {"as_of_ns", list.as_of_ns}};
  json.update(ListToJson("sources", list.sources));
  return json;
}

Json ToJson(const AudioScan& scan) {
  Json peaks = Json::array();
  for (const AudioPeak& peak : scan.peaks) {
    peaks.push_back({{"azimuth_deg", peak.azimuth_rad * kDegPerRad},
                     {"elevation_deg", peak.elevation_rad * kDegPerRad},
                     {"power", peak.power}});
  }
  Json json = {{"time_ns", scan.time_ns},
               {"robot", scan.robot},
               {"session", scan.session},
               {"pose", scan.pose ? ToJson(*scan.pose) : Json(nullptr)},
               {"noise_floor", scan.noise_floor},
               {"peaks", std::move(peaks)},
               {"end_point_count", scan.end_point_count}};
  if (!scan.band.empty()) json["band"] = scan.band;
  return json;
}

Json ToJson(const VoxelColumns& voxels, std::size_t i) {
  // To the micrometre: (key + 0.5) * 0.05 is 2.025, not 2.0250000000000004.
  const auto tidy = [](double metres) { return std::round(metres * 1e6) / 1e6; };
  const Vector3 center = voxels.CenterInMap(i);
  return {{"x_m", tidy(center.x)},
          {"y_m", tidy(center.y)},
          {"z_m", tidy(center.z)},
          {"log_odds", ShortestDecimal(voxels.log_odds[i])},
          {"update_count", voxels.update_count[i]},
          {"last_update_ns", voxels.last_update_ns[i]}};
}

Json ToJson(const ExportedMap& exported) {
  return {{"files", exported.files},
          {"bytes", exported.bytes},
          {"revision", exported.revision},
          {"as_of_ns", exported.as_of_ns}};
}

std::optional<Json> ToJson(const WatchEvent& event) {
  struct Content {
    std::optional<Json> operator()(const Heartbeat&) const { return std::nullopt; }
    std::optional<Json> operator()(const SoundSource& source) const {
      return Json{{"event", "sound_source"}, {"sound_source", ToJson(source)}};
    }
    std::optional<Json> operator()(const RemovedSoundSource& removed) const {
      return Json{{"event", "sound_source_removed"}, {"id", removed.id}};
    }
    std::optional<Json> operator()(const SoundSourceEvent& event) const {
      Json json{{"event", NameOf(event.kind)}, {"time_ns", event.time_ns}};
      json["sound_source"] = ToJson(event.source);
      if (!event.other_id.empty()) json["other"] = event.other_id;
      if (event.from_in_map_m) json["from_m"] = ToJson(*event.from_in_map_m);
      return json;
    }
    std::optional<Json> operator()(const Robot& robot) const {
      return Json{{"event", "robot"}, {"robot", ToJson(robot)}};
    }
    std::optional<Json> operator()(const LiveRobot& robot) const {
      Json json{{"event", "live_robot"}, {"robot", robot.robot}};
      json["live"] = robot.live ? ToJson(*robot.live) : Json(nullptr);
      if (robot.clock_offset) json["clock_offset"] = ToJson(*robot.clock_offset);
      return json;
    }
    std::optional<Json> operator()(const AudioScan& scan) const {
      Json json{{"event", "audio_scan"}};
      json.update(ToJson(scan));
      return json;
    }
    std::optional<Json> operator()(const SnapshotComplete&) const {
      return Json{{"event", "snapshot_complete"}};
    }
    std::optional<Json> operator()(const Resync&) const { return Json{{"event", "resync"}}; }
  };
  auto json = std::visit(Content{}, event.event);
  if (json) {
    (*json)["revision"] = event.revision;
    (*json)["resume_token"] = event.resume_token;
  }
  return json;
}

}  // namespace soundmap::cli
