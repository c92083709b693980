#include "pipeline/records.h"

#include <cmath>
#include <concepts>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"

namespace soundmap::pipeline {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxClockOffsets = 32;

// A fraction or a number that Integer cannot hold is an error; get() would cast it as it comes.
template <std::integral Integer = std::int64_t>
Integer IntegerFrom(const Json& json) {
  const bool fits =
      json.is_number_unsigned()
          ? std::in_range<Integer>(json.get<std::uint64_t>())
          : json.is_number_integer() && std::in_range<Integer>(json.get<std::int64_t>());
  if (!fits) throw Json::type_error::create(302, "a number is no integer of its size", &json);
  return json.get<Integer>();
}

Json JsonFrom(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

Eigen::Vector3d VectorFrom(const Json& json) {
  return {json.at(0).get<double>(), json.at(1).get<double>(), json.at(2).get<double>()};
}

// The upper three rows of the matrix, so that it is read back bit for bit.
Json JsonFrom(const Eigen::Isometry3d& transform) {
  Json rows = Json::array();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) rows.push_back(transform.matrix()(row, column));
  }
  return rows;
}

Eigen::Isometry3d TransformFrom(const Json& json) {
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  for (int i = 0; i < 12; ++i) transform.matrix()(i / 4, i % 4) = json.at(i).get<double>();
  return transform;
}

Json JsonFrom(const frames::Calibration& calibration) {
  Json microphones = Json::array();
  for (const Eigen::Vector3d& mic : calibration.mic_in_array_m)
    microphones.push_back(JsonFrom(mic));
  Json json = {{"base_from_array", JsonFrom(calibration.base_from_array)},
               {"base_from_lidar", JsonFrom(calibration.base_from_lidar)},
               {"base_from_laser", JsonFrom(calibration.base_from_laser)},
               {"mic_in_array_m", std::move(microphones)},
               {"laser_time_increment_s", calibration.laser_time_increment_s},
               {"audio_sample_rate_hz", calibration.audio_sample_rate_hz}};
  if (calibration.full_scale_spl_db) json["full_scale_spl_db"] = *calibration.full_scale_spl_db;
  return json;
}

frames::Calibration CalibrationFrom(const Json& json) {
  frames::Calibration calibration;
  calibration.base_from_array = TransformFrom(json.at("base_from_array"));
  calibration.base_from_lidar = TransformFrom(json.at("base_from_lidar"));
  calibration.base_from_laser = TransformFrom(json.at("base_from_laser"));
  for (const Json& mic : json.at("mic_in_array_m")) {
    calibration.mic_in_array_m.push_back(VectorFrom(mic));
  }
  calibration.laser_time_increment_s = json.at("laser_time_increment_s");
  calibration.audio_sample_rate_hz = IntegerFrom<int>(json.at("audio_sample_rate_hz"));
  if (json.contains("full_scale_spl_db")) {
    calibration.full_scale_spl_db = json.at("full_scale_spl_db").get<double>();
  }
  return calibration;
}

template <typename Record>
absl::StatusOr<Record> Read(const std::string& text, const char* what,
                            Record (*from_json)(const Json&)) {
  // nlohmann-json reports a missing or mistyped field by exception.
  try {
    return from_json(Json::parse(text));
  } catch (const Json::exception& error) {
    return absl::DataLossError(
        absl::StrCat("the stored ", what, " cannot be read: ", error.what()));
  }
}

}  // namespace

std::int64_t ClockOffset::UncertaintyAt(frames::TimeNs at_ns) const {
  const double age_ns = std::abs(static_cast<double>(at_ns) - static_cast<double>(time_ns));
  return uncertainty_ns + static_cast<std::int64_t>(std::ceil(1e-6 * drift_ppm * age_ns));
}

bool SessionRecord::Take(const ClockOffset& newest) {
  bool jumped = false;
  if (!clock_offsets.empty()) {
    const ClockOffset& last = clock_offsets.back();
    jumped = std::abs(newest.server_minus_robot_ns - last.server_minus_robot_ns) >
             last.UncertaintyAt(newest.time_ns) + newest.uncertainty_ns;
  }
  if (clock_offsets.empty() || (jumped && clock_offsets.size() < kMaxClockOffsets)) {
    clock_offsets.push_back(newest);
  } else {
    clock_offsets.back() = newest;
  }
  return jumped;
}

std::int64_t SessionRecord::lost_frames() const {
  std::int64_t frames = 0;
  for (const Gap& gap : gaps) frames += gap.frames;
  return frames;
}

std::optional<ClockOffset> SessionRecord::newest_offset() const {
  if (clock_offsets.empty()) return std::nullopt;
  return clock_offsets.back();
}

std::string ToJson(const SiteRecord& record) {
  Json json{{"version", 1},
            {"site", record.site},
            {"profile", record.profile},
            {"parameters_toml", record.parameters_toml},
            {"create_time_ns", record.create_time_ns},
            {"building_version", record.building_version},
            {"building_sessions", record.building_sessions},
            {"create_request_id", record.create_request_id},
            {"keep_frames_s", record.keep_frames_s}};
  for (const Band& band : record.bands) {
    json["bands"].push_back(
        {{"name", band.name}, {"f_min_hz", band.f_min_hz}, {"f_max_hz", band.f_max_hz}});
  }
  return json.dump();
}

std::string ToJson(const SessionRecord& record) {
  Json json{{"version", 1},
            {"site", record.site},
            {"session", record.session},
            {"robot", record.robot},
            {"purpose", record.purpose == Purpose::kMapping ? "mapping" : "listening"},
            {"calibration", JsonFrom(record.calibration)},
            {"warnings", record.warnings},
            {"epoch", record.epoch},
            {"create_time_ns", record.create_time_ns},
            {"building_version", record.building_version},
            {"complete", record.complete},
            {"frame_count", record.frame_count},
            {"first_frame_ns", record.first_frame_ns},
            {"last_frame_ns", record.last_frame_ns},
            {"audio_scans", record.audio_scans},
            {"frames_dropped", record.frames_dropped}};
  if (record.initial_pose) {
    json["initial_pose"] = {record.initial_pose->x_m, record.initial_pose->y_m,
                            record.initial_pose->yaw_rad};
  }
  for (const Gap& gap : record.gaps) {
    json["gaps"].push_back({{"offset", gap.offset},
                            {"frames", gap.frames},
                            {"from_ns", gap.from_ns},
                            {"to_ns", gap.to_ns},
                            {"reason", gap.reason}});
  }
  for (const ClockOffset& offset : record.clock_offsets) {
    json["clock_offsets"].push_back({{"server_minus_robot_ns", offset.server_minus_robot_ns},
                                     {"uncertainty_ns", offset.uncertainty_ns},
                                     {"time_ns", offset.time_ns},
                                     {"drift_ppm", offset.drift_ppm}});
  }
  return json.dump();
}

absl::StatusOr<SiteRecord> SiteRecordFromJson(const std::string& text) {
  return Read<SiteRecord>(text, "site", [](const Json& json) {
    SiteRecord record;
    record.site = json.at("site");
    record.profile = json.at("profile");
    record.parameters_toml = json.at("parameters_toml");
    record.create_time_ns = IntegerFrom(json.at("create_time_ns"));
    record.building_version = IntegerFrom(json.at("building_version"));
    record.building_sessions = json.value("building_sessions", std::vector<std::string>{});
    record.create_request_id = json.value("create_request_id", "");
    record.keep_frames_s = IntegerFrom(json.value("keep_frames_s", Json(0)));
    for (const Json& band : json.value("bands", Json::array())) {
      record.bands.push_back({band.at("name"), band.at("f_min_hz"), band.at("f_max_hz")});
    }
    return record;
  });
}

absl::StatusOr<SessionRecord> SessionRecordFromJson(const std::string& text) {
  return Read<SessionRecord>(text, "session", [](const Json& json) {
    SessionRecord record;
    record.site = json.at("site");
    record.session = json.at("session");
    record.robot = json.at("robot");
    record.purpose = json.at("purpose") == "mapping" ? Purpose::kMapping : Purpose::kListening;
    record.calibration = CalibrationFrom(json.at("calibration"));
    if (json.contains("initial_pose")) {
      const Eigen::Vector3d pose = VectorFrom(json.at("initial_pose"));
      record.initial_pose = geometry::Pose2{pose.x(), pose.y(), pose.z()};
    }
    record.warnings = json.at("warnings").get<std::vector<std::string>>();
    record.epoch = IntegerFrom(json.at("epoch"));
    record.create_time_ns = IntegerFrom(json.at("create_time_ns"));
    record.building_version = IntegerFrom(json.at("building_version"));
    record.complete = json.at("complete");
    record.frame_count = IntegerFrom(json.at("frame_count"));
    record.first_frame_ns = IntegerFrom(json.at("first_frame_ns"));
    record.last_frame_ns = IntegerFrom(json.at("last_frame_ns"));
    record.audio_scans = IntegerFrom(json.at("audio_scans"));
    record.frames_dropped = json.value("frames_dropped", false);
    for (const Json& gap : json.value("gaps", Json::array())) {
      record.gaps.push_back({IntegerFrom(gap.at("offset")), IntegerFrom(gap.at("frames")),
                             IntegerFrom(gap.at("from_ns")), IntegerFrom(gap.at("to_ns")),
                             gap.at("reason")});
    }
    for (const Json& offset : json.value("clock_offsets", Json::array())) {
      record.clock_offsets.push_back({IntegerFrom(offset.at("server_minus_robot_ns")),
                                      IntegerFrom(offset.at("uncertainty_ns")),
                                      IntegerFrom(offset.at("time_ns")), offset.at("drift_ppm")});
    }
    return record;
  });
}

}  // namespace soundmap::pipeline
