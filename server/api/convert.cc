#include "api/convert.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "api/resource_names.h"
#include "geometry/directions.h"

namespace soundmap::api {
namespace {

void Set(v1::Vector3* proto, const Eigen::Vector3d& vector) {
  proto->set_x(vector.x());
  proto->set_y(vector.y());
  proto->set_z(vector.z());
}

void Set(v1::Transform* proto, const Eigen::Isometry3d& transform) {
  Set(proto->mutable_translation_m(), transform.translation());
  const Eigen::Quaterniond rotation(transform.linear());
  proto->mutable_rotation()->set_x(rotation.x());
  proto->mutable_rotation()->set_y(rotation.y());
  proto->mutable_rotation()->set_z(rotation.z());
  proto->mutable_rotation()->set_w(rotation.w());
}

absl::StatusOr<Eigen::Isometry3d> TransformFrom(const v1::Transform& proto, const char* name) {
  const auto& q = proto.rotation();
  const auto& t = proto.translation_m();
  const Eigen::Quaterniond rotation = proto.has_rotation()
                                          ? Eigen::Quaterniond(q.w(), q.x(), q.y(), q.z())
                                          : Eigen::Quaterniond::Identity();
  const Eigen::Vector3d translation(t.x(), t.y(), t.z());
  if (!translation.allFinite() || !rotation.coeffs().allFinite() ||
      std::abs(rotation.norm() - 1.0) > 1e-3) {
    return absl::InvalidArgumentError(
        absl::StrCat("the calibration's ", name, " is not a finite rigid transform"));
  }
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  transform.linear() = rotation.normalized().toRotationMatrix();
  transform.translation() = translation;
  return transform;
}

v1::LocalizationState ToProto(localization::State state) {
  switch (state) {
    case localization::State::kTracking:
      return v1::LOCALIZATION_STATE_TRACKING;
    case localization::State::kUncertain:
      return v1::LOCALIZATION_STATE_UNCERTAIN;
    case localization::State::kLost:
      return v1::LOCALIZATION_STATE_LOST;
  }
  return v1::LOCALIZATION_STATE_UNSPECIFIED;
}

}  // namespace

v1::Pose2 ToProto(const geometry::Pose2& pose) {
  v1::Pose2 proto;
  proto.set_x_m(pose.x_m);
  proto.set_y_m(pose.y_m);
  proto.set_yaw_rad(pose.yaw_rad);
  return proto;
}

v1::PoseEstimate ToProto(const localization::PoseEstimate& pose) {
  v1::PoseEstimate proto;
  proto.set_time_ns(pose.stamp_ns);
  *proto.mutable_map_from_base() = ToProto(pose.map_from_base);
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) proto.add_covariance(pose.covariance(row, column));
  }
  proto.set_effective_particles(pose.effective_particles);
  proto.set_state(ToProto(pose.state));
  return proto;
}

v1::Calibration ToProto(const frames::Calibration& calibration) {
  v1::Calibration proto;
  Set(proto.mutable_base_from_array(), calibration.base_from_array);
  Set(proto.mutable_base_from_lidar(), calibration.base_from_lidar);
  Set(proto.mutable_base_from_laser(), calibration.base_from_laser);
  for (const Eigen::Vector3d& mic : calibration.mic_in_array_m)
    Set(proto.add_mic_in_array_m(), mic);
  proto.set_laser_time_increment_s(calibration.laser_time_increment_s);
  proto.set_audio_sample_rate_hz(calibration.audio_sample_rate_hz);
  if (calibration.full_scale_spl_db) {
    proto.set_full_scale_spl_db(*calibration.full_scale_spl_db);
  }
  return proto;
}

v1::Site ToProto(const pipeline::Site& site) {
  const pipeline::SiteRecord record = site.record();
  v1::Site proto;
  proto.set_name(SiteResource(record.site));
  proto.set_profile(record.profile);
  proto.set_create_time_ns(record.create_time_ns);
  proto.set_building_version(record.building_version);
  proto.set_parameters_toml(record.parameters_toml);
  proto.set_voxel_size_m(site.profile().sound_map.voxel_size_m);
  proto.set_max_range_m(site.profile().ray_casting.max_range_m);
  proto.set_keep_frames_s(record.keep_frames_s);
  for (const pipeline::Band& band : record.bands) {
    v1::Band& wire = *proto.add_bands();
    wire.set_name(band.name);
    wire.set_min_frequency_hz(band.f_min_hz);
    wire.set_max_frequency_hz(band.f_max_hz);
  }
  return proto;
}

v1::Session ToProto(const pipeline::Session& session) {
  const pipeline::SessionRecord record = session.record();
  const pipeline::Watermarks watermarks = session.watermarks();
  const absl::Status fault = session.fault();
  v1::Session proto;
  proto.set_name(SessionResource(record.site, record.session));
  proto.set_robot(RobotResource(record.robot));
  proto.set_purpose(record.purpose == pipeline::Purpose::kMapping ? v1::PURPOSE_MAPPING
                                                                  : v1::PURPOSE_LISTENING);
  *proto.mutable_calibration() = ToProto(record.calibration);
  if (record.initial_pose) *proto.mutable_initial_pose() = ToProto(*record.initial_pose);
  proto.set_state(!fault.ok()           ? v1::SESSION_STATE_FAILED
                  : watermarks.complete ? v1::SESSION_STATE_COMPLETE
                                        : v1::SESSION_STATE_OPEN);
  proto.set_error_message(std::string(fault.message()));
  for (const std::string& warning : record.warnings) proto.add_warnings(warning);
  proto.set_epoch(record.epoch);
  proto.set_received(watermarks.received);
  proto.set_durable(watermarks.durable);
  proto.set_processed(watermarks.processed);
  proto.set_create_time_ns(record.create_time_ns);
  proto.set_first_frame_time_ns(record.first_frame_ns);
  proto.set_last_frame_time_ns(record.last_frame_ns);
  proto.set_building_version(record.building_version);
  proto.set_audio_scans(record.audio_scans);
  proto.set_frames_dropped(record.frames_dropped);
  for (const pipeline::Gap& gap : record.gaps) {
    v1::FrameGap& wire = *proto.add_gaps();
    wire.set_offset(gap.offset);
    wire.set_frames(gap.frames);
    wire.set_from_ns(gap.from_ns);
    wire.set_to_ns(gap.to_ns);
    wire.set_reason(gap.reason);
  }
  for (const pipeline::ClockOffset& offset : record.clock_offsets) {
    *proto.add_clock_offsets() = ToProto(offset);
  }
  return proto;
}

v1::Robot ToProto(const pipeline::RobotInfo& robot) {
  v1::Robot proto;
  proto.set_name(RobotResource(robot.robot));
  proto.set_site(SiteResource(robot.site));
  if (!robot.session.empty()) proto.set_session(SessionResource(robot.site, robot.session));
  proto.set_streaming(robot.streaming);
  if (robot.pose) *proto.mutable_pose() = ToProto(*robot.pose);
  proto.set_last_seen_ns(robot.last_seen_ns);
  proto.set_lost_frames(robot.lost_frames);
  if (robot.live) *proto.mutable_live() = ToProto(robot.site, *robot.live);
  if (robot.clock_offset) *proto.mutable_clock_offset() = ToProto(*robot.clock_offset);
  return proto;
}

std::string SourceId(const std::string& band, std::uint64_t id) {
  return absl::StrCat(band, band.empty() ? "" : "-", absl::Hex(id, absl::kZeroPad16));
}

v1::SoundSourceState ToProto(sound_map::SourceState state) {
  switch (state) {
    case sound_map::SourceState::kActive:
      return v1::SOUND_SOURCE_STATE_ACTIVE;
    case sound_map::SourceState::kSilent:
      return v1::SOUND_SOURCE_STATE_SILENT;
    case sound_map::SourceState::kGone:
      return v1::SOUND_SOURCE_STATE_GONE;
  }
  return v1::SOUND_SOURCE_STATE_UNSPECIFIED;
}

v1::SoundSource ToProto(const std::string& site, const std::string& band,
                        const sound_map::RegisteredSource& registered, const TimeWindow& periods) {
  v1::SoundSource proto = ToProto(site, band, registered);
  for (const sound_map::HeardPeriod& period : registered.heard) {
    if (!periods.Overlaps(period)) continue;
    v1::HeardPeriod* heard = proto.add_heard_periods();
    heard->set_start_ns(period.begin_ns);
    heard->set_end_ns(period.end_ns);
  }
  return proto;
}

v1::SoundSource ToProto(const std::string& site, const std::string& band,
                        const sound_map::RegisteredSource& registered) {
  const sound_map::SoundSource& source = registered.found;
  v1::SoundSource proto;
  proto.set_name(SoundSourceResource(site, SourceId(band, source.id)));
  proto.set_band(band);
  Set(proto.mutable_position_m(), source.position_in_map_m);
  proto.set_extent_m(source.extent_m);
  proto.set_probability(source.probability);
  proto.set_evidence_count(source.evidence_count);
  proto.set_first_heard_ns(source.first_heard_ns);
  proto.set_last_heard_ns(source.last_heard_ns);
  proto.set_peak_log_odds(source.peak_log_odds);
  proto.set_voxel_count(source.voxel_count);
  proto.set_state(ToProto(registered.state));
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      proto.add_position_covariance_m2(registered.position_covariance_m2(row, column));
    }
  }
  proto.set_view_point_count(static_cast<std::int64_t>(registered.view_points.size()));
  for (const std::string& robot : registered.robots) proto.add_robots(RobotResource(robot));
  proto.set_last_listened_ns(registered.last_listened_ns);
  const sound_map::Spectrum spectrum_db = registered.Spectrum_db();
  const sound_map::Spectrum spectrum_spl_db = registered.SpectrumSpl_db();
  if (const auto level_db = sound_map::TotalLevel_db(spectrum_db)) proto.set_level_db(*level_db);
  if (const auto spl_db = sound_map::TotalLevel_db(spectrum_spl_db)) proto.set_spl_db(*spl_db);
  for (int band = 0; band < frames::kOctaveBands; ++band) {
    if (!spectrum_db[band]) continue;
    v1::OctaveBandLevel* level = proto.add_spectrum();
    level->set_centre_hz(frames::OctaveCentre_hz(band));
    level->set_level_db(*spectrum_db[band]);
    if (spectrum_spl_db[band]) level->set_spl_db(*spectrum_spl_db[band]);
  }
  if (registered.explained_by_id != 0) {
    proto.set_explained_by(SoundSourceResource(site, SourceId(band, registered.explained_by_id)));
  }
  if (registered.mirror_in_map_m) {
    Set(proto.mutable_mirror_position_m(), *registered.mirror_in_map_m);
  }
  return proto;
}

v1::SoundSourceEvent ToProto(const std::string& site, const std::string& band,
                             const sound_map::SourceEvent& event) {
  using Kind = sound_map::SourceEvent::Kind;
  v1::SoundSourceEvent proto;
  switch (event.kind) {
    case Kind::kAppeared:
      proto.set_kind(v1::SoundSourceEvent::KIND_APPEARED);
      break;
    case Kind::kFellSilent:
      proto.set_kind(v1::SoundSourceEvent::KIND_FELL_SILENT);
      break;
    case Kind::kActiveAgain:
      proto.set_kind(v1::SoundSourceEvent::KIND_ACTIVE_AGAIN);
      break;
    case Kind::kVanished:
      proto.set_kind(v1::SoundSourceEvent::KIND_VANISHED);
      break;
    case Kind::kMerged:
      proto.set_kind(v1::SoundSourceEvent::KIND_MERGED);
      break;
    case Kind::kMoved:
      proto.set_kind(v1::SoundSourceEvent::KIND_MOVED);
      Set(proto.mutable_from_m(), event.from_in_map_m);
      break;
  }
  proto.set_time_ns(event.time_ns);
  *proto.mutable_sound_source() = ToProto(site, band, event.source);
  if (event.other_id != 0) {
    proto.set_other_sound_source(SoundSourceResource(site, SourceId(band, event.other_id)));
  }
  return proto;
}

v1::AudioScan ToProto(const std::string& site, const std::string& band,
                      const pipeline::AudioScanInfo& scan) {
  v1::AudioScan proto;
  proto.set_band(band);
  proto.set_session(SessionResource(site, scan.session));
  proto.set_robot(RobotResource(scan.robot));
  proto.set_time_ns(scan.time_ns);
  *proto.mutable_pose() = ToProto(scan.pose);
  proto.set_noise_floor(scan.noise_floor);
  for (const acoustics::Peak& peak : scan.peaks) {
    const geometry::DirectionAngles angles = geometry::AnglesFromDirection(peak.direction_in_array);
    v1::AudioPeak* proto_peak = proto.add_peaks();
    proto_peak->set_azimuth_rad(angles.azimuth_rad);
    proto_peak->set_elevation_rad(angles.elevation_rad);
    proto_peak->set_power(peak.power);
  }
  proto.set_end_point_count(scan.end_points);
  return proto;
}

v1::Operation ToProto(const pipeline::OperationInfo& operation) {
  v1::Operation proto;
  proto.set_name(OperationResource(operation.id));
  proto.set_kind(operation.kind);
  if (!operation.site.empty()) proto.set_site(SiteResource(operation.site));
  proto.set_done(operation.done);
  proto.set_progress(operation.progress);
  proto.set_progress_text(operation.progress_text);
  proto.set_error_code(static_cast<int>(operation.status.code()));
  proto.set_error_message(std::string(operation.status.message()));
  proto.set_create_time_ns(operation.create_time_ns);
  proto.set_end_time_ns(operation.end_time_ns);
  proto.set_report_json(operation.report_json);
  return proto;
}

absl::StatusOr<geometry::Pose2> FromProto(const v1::Pose2& proto) {
  const geometry::Pose2 pose{proto.x_m(), proto.y_m(), proto.yaw_rad()};
  if (!std::isfinite(pose.x_m) || !std::isfinite(pose.y_m) || !std::isfinite(pose.yaw_rad)) {
    return absl::InvalidArgumentError("a pose is not finite");
  }
  return pose;
}

pipeline::Band FromProto(const v1::Band& proto) {
  return {proto.name(), proto.min_frequency_hz(), proto.max_frequency_hz()};
}

absl::StatusOr<frames::Calibration> FromProto(const v1::Calibration& proto) {
  frames::Calibration calibration;
  const struct {
    const v1::Transform& from;
    Eigen::Isometry3d& to;
    const char* name;
  } mounts[] = {{proto.base_from_array(), calibration.base_from_array, "base_from_array"},
                {proto.base_from_lidar(), calibration.base_from_lidar, "base_from_lidar"},
                {proto.base_from_laser(), calibration.base_from_laser, "base_from_laser"}};
  for (const auto& mount : mounts) {
    const auto transform = TransformFrom(mount.from, mount.name);
    if (!transform.ok()) return transform.status();
    mount.to = *transform;
  }
  for (const v1::Vector3& mic : proto.mic_in_array_m()) {
    calibration.mic_in_array_m.emplace_back(mic.x(), mic.y(), mic.z());
  }
  calibration.laser_time_increment_s = proto.laser_time_increment_s();
  calibration.audio_sample_rate_hz = proto.audio_sample_rate_hz();
  if (proto.has_full_scale_spl_db()) calibration.full_scale_spl_db = proto.full_scale_spl_db();
  const absl::Status valid = calibration.Validate();
  if (!valid.ok()) return valid;
  return calibration;
}

}  // namespace soundmap::api
