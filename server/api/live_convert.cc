#include <algorithm>
#include <chrono>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "api/convert.h"
#include "api/resource_names.h"

namespace soundmap::api {
namespace {

constexpr int kMaxBeams = 180;
constexpr std::int64_t kMaxTime_ns = std::int64_t{1} << 62;         // in 2116
constexpr std::int64_t kMaxUncertainty_ns = std::int64_t{1} << 53;  // 104 days
constexpr double kMaxDrift_ppm = 1000.0;
constexpr double kMaxPosition_m = 1e6;

absl::Status CheckTime(std::int64_t time_ns, const char* what) {
  if (time_ns >= 0 && time_ns <= kMaxTime_ns) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("the live report's time of ", what, " is out of range"));
}

absl::StatusOr<pipeline::ClockOffset> FromProto(const v1::ClockOffset& proto, std::int64_t now_ns) {
  // The difference of two offsets fits into 64 bits.
  if (std::abs(static_cast<double>(proto.server_minus_robot_ns())) >=
          static_cast<double>(kMaxTime_ns) ||
      proto.uncertainty_ns() < 0 || proto.uncertainty_ns() > kMaxUncertainty_ns ||
      !(proto.drift_ppm() >= 0.0 && proto.drift_ppm() <= kMaxDrift_ppm)) {
    return absl::InvalidArgumentError("the live report's clock offset is out of range");
  }
  return pipeline::ClockOffset{proto.server_minus_robot_ns(), proto.uncertainty_ns(), now_ns,
                               proto.drift_ppm()};
}

absl::StatusOr<std::shared_ptr<const frames::LaserScan>> FromProto(const v1::LaserView& proto) {
  if (proto.range_m_size() > kMaxBeams) {
    return absl::InvalidArgumentError(absl::StrCat("the live report's laser scan has ",
                                                   proto.range_m_size(), " beams; ", kMaxBeams,
                                                   " are the limit"));
  }
  const bool valid =
      std::isfinite(proto.start_angle_rad()) && std::isfinite(proto.angle_increment_rad()) &&
      std::all_of(proto.range_m().begin(), proto.range_m().end(),
                  [](float range_m) { return std::isfinite(range_m) && range_m >= 0.0f; });
  if (!valid) {
    return absl::InvalidArgumentError("the live report's laser scan has a number that is none");
  }
  const absl::Status time = CheckTime(proto.time_ns(), "the laser scan");
  if (!time.ok()) return time;
  return std::make_shared<const frames::LaserScan>(
      frames::LaserScan{proto.time_ns(),
                        proto.start_angle_rad(),
                        proto.angle_increment_rad(),
                        {proto.range_m().begin(), proto.range_m().end()}});
}

}  // namespace

absl::StatusOr<pipeline::LiveReport> FromProto(const v1::LiveReport& proto, std::int64_t now_ns) {
  pipeline::LiveReport report;
  report.recording = proto.drive_state() == v1::DRIVE_STATE_RECORDING;
  report.recorded_frames = proto.recorded_frames();
  if (report.recorded_frames < 0) {
    return absl::InvalidArgumentError("the live report's count of frames is negative");
  }
  if (proto.has_odom_from_base()) {
    const absl::Status time = CheckTime(proto.odometry_time_ns(), "the odometry");
    if (!time.ok()) return time;
    const auto odom_from_base = FromProto(proto.odom_from_base());
    if (!odom_from_base.ok()) return odom_from_base.status();
    if (std::hypot(odom_from_base->x_m, odom_from_base->y_m) > kMaxPosition_m) {
      return absl::InvalidArgumentError("the live report's odometry is out of range");
    }
    report.odometry = frames::Odometry{proto.odometry_time_ns(), *odom_from_base};
  }
  if (proto.has_laser()) {
    auto laser = FromProto(proto.laser());
    if (!laser.ok()) return laser.status();
    report.laser = *std::move(laser);
  }
  if (proto.has_clock_offset()) {
    const auto offset = FromProto(proto.clock_offset(), now_ns);
    if (!offset.ok()) return offset.status();
    report.clock_offset = *offset;
  }
  return report;
}

v1::ClockOffset ToProto(const pipeline::ClockOffset& offset) {
  v1::ClockOffset proto;
  proto.set_server_minus_robot_ns(offset.server_minus_robot_ns);
  proto.set_uncertainty_ns(offset.uncertainty_ns);
  proto.set_time_ns(offset.time_ns);
  proto.set_drift_ppm(offset.drift_ppm);
  return proto;
}

v1::LiveView ToProto(const std::string& site, const pipeline::LiveView& view) {
  const pipeline::LiveReport& report = view.report;
  v1::LiveView proto;
  proto.set_session(SessionResource(site, view.session));
  proto.set_age_ns(std::chrono::duration_cast<std::chrono::nanoseconds>(
                       std::chrono::steady_clock::now() - view.received_at)
                       .count());
  proto.set_drive_state(report.recording ? v1::DRIVE_STATE_RECORDING : v1::DRIVE_STATE_RECORDED);
  proto.set_recorded_frames(report.recorded_frames);
  if (report.odometry) {
    proto.set_odometry_time_ns(report.odometry->stamp_ns);
    *proto.mutable_odom_from_base() = ToProto(report.odometry->odom_from_base);
  }
  if (view.map_from_base) {
    *proto.mutable_map_from_base() = ToProto(*view.map_from_base);
    proto.set_localized_time_ns(view.localized_ns);
  }
  if (report.laser) {
    v1::LaserView& laser = *proto.mutable_laser();
    laser.set_time_ns(report.laser->stamp_ns);
    laser.set_start_angle_rad(report.laser->start_angle_rad);
    laser.set_angle_increment_rad(report.laser->angle_increment_rad);
    laser.mutable_range_m()->Add(report.laser->range_m.begin(), report.laser->range_m.end());
  }
  return proto;
}

}  // namespace soundmap::api
