#include "sources/convert/carmen_log.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"

namespace soundmap::convert {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kMaxStamp_s = 9.2e9;  // int64 nanoseconds end in the year 2262
constexpr double kMaxCoordinate_m = 1e7;
constexpr int kMaxBeams = 100'000;
constexpr std::size_t kNamedLines = 10;

// SICK's range finders, for which FLASER was made, see 80 m at most and report 81 .. 81.91 m for
// dazzled, no signal and the like.
constexpr double kSickCodes_m = 80.0;
// The largest range of a log is a code when it stands alone: occurs often, and often against all
// ranges just below it, which a real surface would spread over.
constexpr double kBelowCode_m = 0.5;
constexpr int kMinCodes = 10;
constexpr double kCodesToRangesBelow = 10.0;

// The laser's pose in the log comes from its mount, unless some program has corrected it.
constexpr double kMountTolerance_m = 0.005;
constexpr double kMountTolerance_rad = 0.005;

std::int64_t NsFromSeconds(double seconds) { return std::llround(seconds * 1e9); }

// Of a laser whose line tells the number of beams alone. Even counts leave out the last direction:
// 180 beams of a half turn are 1 degree apart, 181 too.
double AngleIncrement(std::size_t beams) {
  return beams < 2 ? kPi : kPi / static_cast<double>(beams - beams % 2);
}

PlanarPose MountOf(const CarmenScan& scan) {
  const PlanarPose& base = *scan.odom_from_base;
  const double dx = scan.laser.x_m - base.x_m, dy = scan.laser.y_m - base.y_m;
  const double c = std::cos(base.yaw_rad), s = std::sin(base.yaw_rad);
  return {c * dx + s * dy, c * dy - s * dx,
          std::remainder(scan.laser.yaw_rad - base.yaw_rad, 2.0 * kPi)};
}

std::optional<PlanarPose> MountOf(const std::vector<CarmenScan>& scans) {
  if (!scans.front().odom_from_base) return std::nullopt;
  const PlanarPose mount = MountOf(scans.front());
  for (const CarmenScan& scan : scans) {
    if (!scan.odom_from_base) return std::nullopt;
    const PlanarPose other = MountOf(scan);
    if (std::hypot(other.x_m - mount.x_m, other.y_m - mount.y_m) > kMountTolerance_m ||
        std::abs(std::remainder(other.yaw_rad - mount.yaw_rad, 2.0 * kPi)) > kMountTolerance_rad) {
      return std::nullopt;
    }
  }
  return mount;
}

double NoReturnFrom(const std::vector<CarmenScan>& scans) {
  double limit_m = kSickCodes_m;
  for (const CarmenScan& scan : scans) {
    if (scan.max_range_m > 0.0) limit_m = std::max(limit_m, scan.max_range_m);
  }
  double largest_m = 0.0;
  for (const CarmenScan& scan : scans) {
    for (const float range_m : scan.range_m) {
      if (range_m < limit_m && range_m > largest_m) largest_m = range_m;
    }
  }
  std::int64_t codes = 0, below = 0;
  for (const CarmenScan& scan : scans) {
    for (const float range_m : scan.range_m) {
      if (range_m >= limit_m || range_m < largest_m - kBelowCode_m) continue;
      ++(range_m == static_cast<float>(largest_m) ? codes : below);
    }
  }
  const bool stands_alone =
      codes >= kMinCodes &&
      static_cast<double>(codes) > kCodesToRangesBelow * static_cast<double>(below);
  return stands_alone ? largest_m : limit_m;
}

// Sorted by time; of those at one time the first. Returns how many were left out because the same
// sensor had given a later one or the same before.
template <typename Stamped>
int DropBackward(std::vector<Stamped>& entries) {
  std::int64_t newest_ns = std::numeric_limits<std::int64_t>::min();
  return static_cast<int>(std::erase_if(entries, [&newest_ns](const Stamped& entry) {
    if (entry.stamp_ns <= newest_ns) return true;
    newest_ns = entry.stamp_ns;
    return false;
  }));
}

}  // namespace

// Takes fields off the front of a line.
class CarmenParser::Fields {
 public:
  explicit Fields(std::string_view line)
      : fields_(absl::StrSplit(absl::string_view(line.data(), line.size()),
                               absl::ByAnyChar(" \t\r"), absl::SkipEmpty())) {}

  bool empty() const { return next_ == fields_.size(); }
  std::size_t left() const { return fields_.size() - next_; }
  absl::string_view Text() { return empty() ? absl::string_view() : fields_[next_++]; }
  // NaN and infinities are numbers.
  bool Number(double& number) { return !empty() && absl::SimpleAtod(fields_[next_++], &number); }
  bool Finite(double& number) { return Number(number) && std::isfinite(number); }
  bool Count(int& count) {
    return !empty() && absl::SimpleAtoi(fields_[next_++], &count) && count >= 0 &&
           count <= kMaxBeams;
  }
  bool Pose(PlanarPose& pose) {
    return Finite(pose.x_m) && Finite(pose.y_m) && Finite(pose.yaw_rad) &&
           std::abs(pose.x_m) <= kMaxCoordinate_m && std::abs(pose.y_m) <= kMaxCoordinate_m &&
           std::abs(pose.yaw_rad) <= kMaxCoordinate_m;
  }
  bool Ranges(int count, std::vector<float>& range_m) {
    range_m.clear();
    for (int i = 0; i < count; ++i) {
      double range = 0.0;
      if (!Number(range)) return false;
      range_m.push_back(static_cast<float>(range));
    }
    return true;
  }

 private:
  std::vector<absl::string_view> fields_;
  std::size_t next_ = 0;
};

void CarmenParser::Clock::Add(const Stamp& stamp) {
  const double delay_s = stamp.logger_s - stamp.ipc_s;
  shortest_delay_s = host.empty() ? delay_s : std::min(shortest_delay_s, delay_s);
  if (host.empty()) host = stamp.host;
}

bool CarmenParser::Read(Fields& fields, Stamp& stamp) {
  if (!fields.Finite(stamp.ipc_s) || stamp.ipc_s < 0.0 || stamp.ipc_s > kMaxStamp_s) return false;
  stamp.host = std::string(fields.Text());
  return !stamp.host.empty() && fields.Finite(stamp.logger_s) && fields.empty();
}

// FLASER num_readings [ranges] x y theta odom_x odom_y odom_theta stamp
bool CarmenParser::AddFrontLaser(Fields fields) {
  CarmenScan scan;
  int beams = 0;
  PlanarPose base;
  Stamp stamp;
  if (!fields.Count(beams) || beams == 0 || !fields.Ranges(beams, scan.range_m) ||
      !fields.Pose(scan.laser) || !fields.Pose(base) || !Read(fields, stamp)) {
    return false;
  }
  scan.stamp_ns = NsFromSeconds(stamp.ipc_s);
  scan.start_angle_rad = -kPi / 2.0;
  scan.angle_increment_rad = AngleIncrement(scan.range_m.size());
  scan.odom_from_base = base;
  laser_clock_.Add(stamp);
  log_.scans.push_back(std::move(scan));
  return true;
}

// ROBOTLASER1 and RAWLASER1: laser_type start_angle field_of_view angular_resolution maximum_range
// accuracy remission_mode num_readings [ranges] num_remissions [remissions], then, of ROBOTLASER1,
// laser_pose (3) robot_pose (3) laser_tv laser_rv forward_safety_dist side_safety_dist turn_axis,
// stamp
bool CarmenParser::AddLaser(Fields fields, bool declared, bool with_robot) {
  if (!declared) return AddFrontLaser(std::move(fields));
  CarmenScan scan;
  double skipped = 0.0, field_of_view_rad = 0.0;
  int beams = 0, remissions = 0;
  PlanarPose base;
  Stamp stamp;
  if (!fields.Finite(skipped) || !fields.Finite(scan.start_angle_rad) ||
      !fields.Finite(field_of_view_rad) || !fields.Finite(scan.angle_increment_rad) ||
      !fields.Finite(scan.max_range_m) || !fields.Finite(skipped) || !fields.Finite(skipped) ||
      !fields.Count(beams) || beams == 0 || !fields.Ranges(beams, scan.range_m) ||
      !fields.Count(remissions)) {
    return false;
  }
  for (int i = 0; i < remissions; ++i) {
    if (!fields.Number(skipped)) return false;
  }
  if (with_robot) {
    if (!fields.Pose(scan.laser) || !fields.Pose(base)) return false;
    for (int i = 0; i < 5; ++i) {
      if (!fields.Number(skipped)) return false;
    }
    scan.odom_from_base = base;
  }
  const double turn_rad = scan.angle_increment_rad * beams;
  if (!Read(fields, stamp) || !(std::abs(scan.start_angle_rad) <= 2.0 * kPi) ||
      !(scan.angle_increment_rad > 0.0) || turn_rad > 2.1 * kPi || scan.max_range_m < 0.0) {
    return false;
  }
  scan.stamp_ns = NsFromSeconds(stamp.ipc_s);
  laser_clock_.Add(stamp);
  log_.scans.push_back(std::move(scan));
  return true;
}

// ODOM x y theta tv rv accel stamp
bool CarmenParser::AddOdometry(Fields fields) {
  CarmenOdometry odometry;
  double skipped = 0.0;
  Stamp stamp;
  if (!fields.Pose(odometry.odom_from_base) || !fields.Number(skipped) || !fields.Number(skipped) ||
      !fields.Number(skipped) || !Read(fields, stamp)) {
    return false;
  }
  odometry.stamp_ns = NsFromSeconds(stamp.ipc_s);
  odometry_clock_.Add(stamp);
  log_.odometry.push_back(odometry);
  return true;
}

void CarmenParser::Add(std::string_view line, int number) {
  Fields fields(line);
  const absl::string_view kind = fields.Text();
  bool well_formed = true;
  if (kind == "FLASER") {
    well_formed = AddLaser(std::move(fields), /*declared=*/false, /*with_robot=*/true);
  } else if (kind == "ROBOTLASER1") {
    well_formed = AddLaser(std::move(fields), /*declared=*/true, /*with_robot=*/true);
  } else if (kind == "RAWLASER1") {
    well_formed = AddLaser(std::move(fields), /*declared=*/true, /*with_robot=*/false);
  } else if (kind == "ODOM") {
    well_formed = AddOdometry(std::move(fields));
  } else if (kind == "PARAM") {
    if (fields.Text() == "robot_frontlaser_offset") {
      double offset_m = 0.0;
      well_formed = fields.Finite(offset_m) && std::abs(offset_m) < 100.0;
      if (well_formed) front_laser_offset_m_ = offset_m;
    }
  } else if (kind == "RLASER" || kind == "LASER3" || kind == "LASER4" || kind == "ROBOTLASER2" ||
             kind == "RAWLASER2" || kind == "RAWLASER3" || kind == "RAWLASER4") {
    ++log_.other_lasers;
  }
  if (well_formed) return;
  ++log_.malformed_lines;
  if (log_.malformed_line_numbers.size() < kNamedLines) {
    log_.malformed_line_numbers.push_back(number);
  }
}

absl::StatusOr<CarmenLog> CarmenParser::Finish(std::optional<double> max_range_m) {
  if (log_.scans.empty()) {
    return absl::InvalidArgumentError("it has no usable line of a front laser");
  }
  if (log_.odometry.empty()) {
    for (const CarmenScan& scan : log_.scans) {
      if (scan.odom_from_base) log_.odometry.push_back({scan.stamp_ns, *scan.odom_from_base});
    }
    odometry_clock_ = laser_clock_;
  }
  if (odometry_clock_.host != laser_clock_.host) {
    const std::int64_t shift_ns =
        NsFromSeconds(odometry_clock_.shortest_delay_s - laser_clock_.shortest_delay_s);
    for (CarmenOdometry& odometry : log_.odometry) odometry.stamp_ns += shift_ns;
    std::erase_if(log_.odometry, [](const CarmenOdometry& entry) { return entry.stamp_ns < 0; });
  }
  log_.backward_scans = DropBackward(log_.scans);
  log_.backward_odometry = DropBackward(log_.odometry);
  if (const auto mount = MountOf(log_.scans)) {
    log_.base_from_laser = *mount;
  } else {
    log_.base_from_laser.x_m = front_laser_offset_m_.value_or(0.0);
  }
  log_.no_return_from_m = max_range_m.value_or(NoReturnFrom(log_.scans));
  return std::move(log_);
}

}  // namespace soundmap::convert
