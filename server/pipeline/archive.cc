#include "pipeline/archive.h"

#include <boost/serialization/map.hpp>

#include "absl/strings/str_cat.h"
#include "pipeline/serialization.h"

namespace boost::serialization {

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::SoundSource& source, unsigned) {
  archive& source.id& source.position_in_map_m& source.extent_m& source.probability& source
      .evidence& source.evidence_count& source.voxel_count& source.peak_log_odds& source
      .first_heard_ns& source.last_heard_ns;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::HeardPeriod& period, unsigned) {
  archive& period.begin_ns& period.end_ns;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::HeardPeak& peak, unsigned) {
  archive& peak.place_in_map_m& peak.power_at_1m;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::ArrayPlane& plane, unsigned) {
  archive& plane.origin_in_map_m& plane.normal_in_map;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::ViewPoint& view_point, unsigned) {
  archive& view_point.place_in_map_m& view_point.array_known& view_point.array_in_map_m& view_point
      .plane_normal_in_map& view_point.surface_normal_sum_in_map& view_point.level_scans& view_point
      .power_at_1m& view_point.spl_scans& view_point.squared_pressure_at_1m;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::RegisteredSource& source, unsigned) {
  archive& source.found& source.state& source.position_covariance_m2& source
      .last_listened_ns& source.robots& source.view_points& source.heard& source.explained_by_id;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::View& view, unsigned) {
  archive& view.begin_in_map_m& view.scans& view.with_maximum;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::FloorEcho& echo, unsigned) {
  archive& echo.scans& echo.at_place& echo.at_image& echo.image_in_map_m;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::SourceRegister::Track& track, unsigned) {
  archive& track.source& track.judged_ns& track.log_odds_on& track.found_ns& track
      .active_until_ns& track.left& track.listened_scans& track.heard_scans& track.sure_scans& track
      .silent_s& track.announced& track.position_scans& track.mean_in_map_m& track.scatter_m2& track
      .views.present& track.views.past& track.views.past_heard& track.views.ended& track.mirrors
      .scans& track.mirrors.with& track.echo;
}

template <class Archive>
void serialize(Archive& archive, soundmap::sound_map::SourceRegister::State& state, unsigned) {
  archive& state.tracks& state.scans& state.last_ns;
}

}  // namespace boost::serialization

namespace soundmap::pipeline {
namespace {

// Of what is stored, and of the rules that sources are judged by: those of other rules are made
// again from the journal.
constexpr std::uint32_t kSourceRegistersVersion = 7;
// Entries from before levels were measured have none, and begin with the length of a name.
constexpr std::uint64_t kAudioScanVersion = 0xffff'ffff'0000'0006;
constexpr std::uint64_t kAudioScanVersionWithoutRipples = 0xffff'ffff'0000'0005;
constexpr std::uint64_t kAudioScanVersionWithoutArray = 0xffff'ffff'0000'0004;
constexpr std::uint64_t kAudioScanVersionWithoutBand = 0xffff'ffff'0000'0003;
constexpr std::uint64_t kAudioScanVersionWithoutPlane = 0xffff'ffff'0000'0002;

}  // namespace

std::string EncodePose(const localization::PoseEstimate& pose) { return ToBytes(pose); }

std::string EncodeAudioScan(const AudioScanInfo& scan) {
  const sound_map::ArrayPlane plane = scan.array_plane.value_or(sound_map::ArrayPlane());
  std::vector<Eigen::Vector3f> surface_normals;
  std::vector<frames::EchoRipple> ripples;
  for (const sound_map::HeardPeak& peak : scan.heard) {
    surface_normals.push_back(peak.surface_normal_in_map);
    ripples.push_back(peak.ripple);
  }
  return ToBytes(kAudioScanVersion, scan.robot, scan.pose, scan.noise_floor, scan.peaks,
                 scan.end_points, scan.heard, scan.array_plane.has_value(), plane,
                 scan.full_scale_spl_db.has_value(), scan.full_scale_spl_db.value_or(0.0),
                 scan.band, scan.array_in_map_m.has_value(),
                 scan.array_in_map_m.value_or(Eigen::Vector3d::Zero()), surface_normals, ripples);
}

std::string EncodeSourceRegisters(const SourceRegisters& registers) {
  return ToBytes(kSourceRegistersVersion, registers);
}

absl::StatusOr<localization::PoseEstimate> DecodePose(const std::string& bytes) {
  localization::PoseEstimate pose;
  const absl::Status status = FromBytes(bytes, pose);
  if (!status.ok()) return status;
  return pose;
}

absl::StatusOr<AudioScanInfo> DecodeAudioScan(const std::string& bytes) {
  std::uint64_t version = 0;
  absl::Status status = FromBytes(bytes, version);
  if (!status.ok()) return status;
  AudioScanInfo scan;
  bool has_plane = false;
  sound_map::ArrayPlane plane;
  bool has_full_scale = false;
  double full_scale_spl_db = 0.0;
  bool has_array = false;
  Eigen::Vector3d array_in_map_m;
  std::vector<Eigen::Vector3f> surface_normals;
  std::vector<frames::EchoRipple> ripples;
  if (version == kAudioScanVersion) {
    status =
        FromBytes(bytes, version, scan.robot, scan.pose, scan.noise_floor, scan.peaks,
                  scan.end_points, scan.heard, has_plane, plane, has_full_scale, full_scale_spl_db,
                  scan.band, has_array, array_in_map_m, surface_normals, ripples);
    if (status.ok() &&
        (surface_normals.size() != scan.heard.size() || ripples.size() != scan.heard.size())) {
      status = absl::DataLossError("an audio scan has other surfaces or ripples than peaks");
    }
  } else if (version == kAudioScanVersionWithoutRipples) {
    status = FromBytes(bytes, version, scan.robot, scan.pose, scan.noise_floor, scan.peaks,
                       scan.end_points, scan.heard, has_plane, plane, has_full_scale,
                       full_scale_spl_db, scan.band, has_array, array_in_map_m, surface_normals);
    if (status.ok() && surface_normals.size() != scan.heard.size()) {
      status = absl::DataLossError("an audio scan has other surfaces than peaks");
    }
  } else if (version == kAudioScanVersionWithoutArray) {
    status = FromBytes(bytes, version, scan.robot, scan.pose, scan.noise_floor, scan.peaks,
                       scan.end_points, scan.heard, has_plane, plane, has_full_scale,
                       full_scale_spl_db, scan.band);
  } else if (version == kAudioScanVersionWithoutBand) {
    status = FromBytes(bytes, version, scan.robot, scan.pose, scan.noise_floor, scan.peaks,
                       scan.end_points, scan.heard, has_plane, plane);
  } else if (version == kAudioScanVersionWithoutPlane) {
    status = FromBytes(bytes, version, scan.robot, scan.pose, scan.noise_floor, scan.peaks,
                       scan.end_points, scan.heard);
  } else {
    status = FromBytes(bytes, scan.robot, scan.pose, scan.noise_floor, scan.peaks, scan.end_points);
  }
  if (!status.ok()) return status;
  if (has_plane) scan.array_plane = plane;
  if (has_full_scale) scan.full_scale_spl_db = full_scale_spl_db;
  if (has_array) scan.array_in_map_m = array_in_map_m;
  for (std::size_t i = 0; i < surface_normals.size(); ++i) {
    scan.heard[i].surface_normal_in_map = surface_normals[i];
  }
  for (std::size_t i = 0; i < ripples.size(); ++i) scan.heard[i].ripple = std::move(ripples[i]);
  return scan;
}

absl::StatusOr<SourceRegisters> DecodeSourceRegisters(const std::string& bytes) {
  std::uint32_t version = 0;
  if (absl::Status status = FromBytes(bytes, version); !status.ok()) return status;
  if (version != kSourceRegistersVersion) {
    return absl::DataLossError(absl::StrCat("the source register has version ", version));
  }
  SourceRegisters registers;
  if (absl::Status status = FromBytes(bytes, version, registers); !status.ok()) return status;
  return registers;
}

}  // namespace soundmap::pipeline
