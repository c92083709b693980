#include "sources/convert/convert.h"

#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "recording/foxglove_messages.h"
#include "recording/writer.h"
#include "sources/convert/carmen_log.h"
#include "sources/convert/compressed_lines.h"

namespace soundmap::convert {
namespace {

Eigen::Isometry3d InSpace(const PlanarPose& pose, double z_m = 0.0) {
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  transform.translation() = Eigen::Vector3d(pose.x_m, pose.y_m, z_m);
  transform.linear() = Eigen::AngleAxisd(pose.yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return transform;
}

struct TruePose {
  std::int64_t stamp_ns = 0;
  Eigen::Isometry3d map_from_body;
};

absl::StatusOr<std::vector<TruePose>> ReadTruth(const std::string& path) {
  std::vector<TruePose> poses;
  absl::Status status;
  const absl::Status read = ForEachLine(path, [&](std::string_view text, int number) {
    const absl::string_view line =
        absl::StripAsciiWhitespace(absl::string_view(text.data(), text.size()));
    if (line.empty() || line[0] == '#' || !status.ok()) return;
    if (poses.empty() && absl::StartsWith(line, "timestamp")) return;
    const std::vector<absl::string_view> fields = absl::StrSplit(line, ',');
    double numbers[4] = {};
    bool usable = fields.size() == 4;
    for (std::size_t i = 0; usable && i < 4; ++i) {
      usable = absl::SimpleAtod(absl::StripAsciiWhitespace(fields[i]), &numbers[i]) &&
               std::abs(numbers[i]) < 9.2e9;  // false for NaN
    }
    if (!usable || numbers[0] < 0.0) {
      status = absl::InvalidArgumentError(
          absl::StrCat("line ", number, " of '", path, "' is not timestamp_s,x,y,yaw"));
      return;
    }
    poses.push_back(
        {std::llround(numbers[0] * 1e9), InSpace({numbers[1], numbers[2], numbers[3]})});
    if (poses.size() > 1 && poses.back().stamp_ns <= poses[poses.size() - 2].stamp_ns) {
      status = absl::InvalidArgumentError(
          absl::StrCat("line ", number, " of '", path, "' is not later than the pose before"));
    }
  });
  if (!read.ok()) return read;
  if (!status.ok()) return status;
  return poses;
}

std::vector<std::string> WarningsOf(const CarmenLog& log) {
  std::vector<std::string> warnings;
  const auto warn_if = [&warnings](int count, absl::string_view what) {
    if (count > 0) warnings.push_back(absl::StrCat(count, " ", what));
  };
  if (log.malformed_lines > 0) {
    const bool all =
        log.malformed_line_numbers.size() == static_cast<std::size_t>(log.malformed_lines);
    warnings.push_back(absl::StrCat(log.malformed_lines, " malformed lines are left out: ",
                                    absl::StrJoin(log.malformed_line_numbers, ", "),
                                    all ? "" : ", ..."));
  }
  warn_if(log.backward_scans, "scans are left out that are not later than the one before");
  warn_if(log.backward_odometry,
          "odometry lines are left out that are not later than the one before");
  warn_if(log.other_lasers, "lines of rear and further lasers are left out");
  if (log.odometry.empty()) warnings.push_back("the log has no odometry");
  return warnings;
}

// The messages of the recording, in order of time.
class Messages {
 public:
  Messages(recording::Writer& writer, const CarmenLog& log, double laser_height_m)
      : writer_(writer),
        log_(log),
        base_from_laser_(InSpace(log.base_from_laser, laser_height_m)) {}

  absl::Status WriteTransforms(std::int64_t stamp_ns) {
    foxglove::FrameTransforms transforms;
    *transforms.add_transforms() =
        recording::MakeFrameTransform(stamp_ns, "base_link", "laser", base_from_laser_);
    return Write(recording::kTransformsTopic, stamp_ns, transforms);
  }

  absl::Status Write(const CarmenOdometry& odometry) {
    return Write(recording::kOdometryTopic, odometry.stamp_ns,
                 recording::MakeOdometry(odometry.stamp_ns, InSpace(odometry.odom_from_base)));
  }

  absl::Status Write(const TruePose& pose, bool of_laser) {
    const Eigen::Isometry3d laser_from_base = InSpace(log_.base_from_laser).inverse();
    return Write(recording::kGroundTruthTopic, pose.stamp_ns,
                 recording::MakePoseInFrame(
                     pose.stamp_ns, "map",
                     of_laser ? pose.map_from_body * laser_from_base : pose.map_from_body));
  }

  absl::Status Write(const CarmenScan& scan, std::int64_t& no_return_beams) {
    std::vector<double> range_m;
    for (const float range : scan.range_m) {
      const bool declared_code = scan.max_range_m > 0.0 && range >= scan.max_range_m;
      const bool valid = range > 0.0f && range < log_.no_return_from_m && !declared_code;
      if (!valid) ++no_return_beams;
      range_m.push_back(valid ? range : std::numeric_limits<double>::infinity());
    }
    const double span_rad = scan.angle_increment_rad * static_cast<double>(range_m.size() - 1);
    return Write(recording::kLaserTopic, scan.stamp_ns,
                 recording::MakeLaserScan(scan.stamp_ns, scan.start_angle_rad,
                                          scan.start_angle_rad + span_rad, range_m));
  }

 private:
  absl::Status Write(std::string_view topic, std::int64_t stamp_ns,
                     const google::protobuf::Message& message) {
    return recording::WriteMessage(writer_, topic, stamp_ns, sequence_++, message);
  }

  recording::Writer& writer_;
  const CarmenLog& log_;
  const Eigen::Isometry3d base_from_laser_;
  std::uint32_t sequence_ = 0;
};

}  // namespace

absl::StatusOr<ConvertResult> Convert(const std::string& log_path, const std::string& out_path,
                                      const ConvertOptions& options) {
  if (options.max_range_m && !(*options.max_range_m > 0.0)) {
    return absl::InvalidArgumentError("the maximum range must be above 0 m");
  }
  if (!(options.laser_height_m >= 0.0 && options.laser_height_m <= 100.0)) {
    return absl::InvalidArgumentError("the laser's height must be from 0 to 100 m");
  }
  ConvertResult result;
  CarmenParser parser;
  result.damage = ForEachLine(
      log_path, [&parser](std::string_view line, int number) { parser.Add(line, number); });
  if (!result.damage.ok() && !absl::IsDataLoss(result.damage)) return result.damage;
  auto parsed = parser.Finish(options.max_range_m);
  if (!parsed.ok()) {
    if (!result.damage.ok()) return result.damage;
    return absl::InvalidArgumentError(
        absl::StrCat("cannot convert '", log_path, "': ", parsed.status().message()));
  }
  const CarmenLog& log = *parsed;
  std::vector<TruePose> truth;
  if (!options.truth_path.empty()) {
    auto poses = ReadTruth(options.truth_path);
    if (!poses.ok()) return poses.status();
    truth = *std::move(poses);
  }

  auto writer = recording::Writer::Create(out_path, {});
  if (!writer.ok()) return writer.status();
  Messages messages(**writer, log, options.laser_height_m);
  std::int64_t first_ns = log.scans.front().stamp_ns;
  std::int64_t last_ns = log.scans.back().stamp_ns;
  if (!log.odometry.empty()) {
    first_ns = std::min(first_ns, log.odometry.front().stamp_ns);
    last_ns = std::max(last_ns, log.odometry.back().stamp_ns);
  }
  absl::Status status = messages.WriteTransforms(first_ns);
  // Of messages at one time: odometry, scan, truth.
  constexpr std::int64_t kNever_ns = std::numeric_limits<std::int64_t>::max();
  auto odometry = log.odometry.begin();
  auto scan = log.scans.begin();
  auto pose = truth.begin();
  while (status.ok()) {
    const std::int64_t odometry_ns =
        odometry == log.odometry.end() ? kNever_ns : odometry->stamp_ns;
    const std::int64_t scan_ns = scan == log.scans.end() ? kNever_ns : scan->stamp_ns;
    const std::int64_t pose_ns = pose == truth.end() ? kNever_ns : pose->stamp_ns;
    if (odometry_ns <= scan_ns && odometry_ns <= pose_ns) {
      if (odometry_ns == kNever_ns) break;
      status = messages.Write(*odometry++);
    } else if (scan_ns <= pose_ns) {
      status = messages.Write(*scan++, result.no_return_beams);
    } else {
      status = messages.Write(*pose++, options.truth_is_of_laser);
    }
  }
  if (status.ok()) status = (*writer)->Close();
  if (!status.ok()) return status;

  result.scans = static_cast<std::int64_t>(log.scans.size());
  result.odometry = static_cast<std::int64_t>(log.odometry.size());
  result.truth_poses = static_cast<std::int64_t>(truth.size());
  result.beams = static_cast<int>(log.scans.front().range_m.size());
  result.duration_s = static_cast<double>(last_ns - first_ns) * 1e-9;
  result.no_return_from_m = log.no_return_from_m;
  result.warnings = WarningsOf(log);
  return result;
}

}  // namespace soundmap::convert
