#include "tests/mapping/laser_drive.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <sstream>

#include "recording/drive.h"
#include "sources/convert/convert.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;
using Complex = std::complex<double>;

Pose2 ToPose2(const foxglove::Pose& pose) {
  const auto& q = pose.orientation();
  return {pose.position().x(), pose.position().y(),
          std::atan2(2 * (q.w() * q.z() + q.x() * q.y()), 1 - 2 * (q.y() * q.y() + q.z() * q.z()))};
}

std::vector<std::vector<double>> Numbers(const std::string& path) {
  std::ifstream file(path);
  std::vector<std::vector<double>> rows;
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream fields(line);
    rows.emplace_back(std::istream_iterator<double>(fields), std::istream_iterator<double>());
  }
  return rows;
}

frames::TimeNs Ns(double seconds) { return std::llround(seconds * 1e9); }

std::optional<Pose2> At(const std::vector<StampedPose>& path, frames::TimeNs time_ns) {
  const auto after = std::lower_bound(
      path.begin(), path.end(), time_ns,
      [](const StampedPose& pose, frames::TimeNs wanted_ns) { return pose.stamp_ns < wanted_ns; });
  if (after == path.end()) return std::nullopt;
  if (after->stamp_ns == time_ns) return after->map_from_base;
  if (after == path.begin()) return std::nullopt;
  const auto before = std::prev(after);
  return geometry::Interpolate(before->map_from_base, after->map_from_base,
                               static_cast<double>(time_ns - before->stamp_ns) /
                                   static_cast<double>(after->stamp_ns - before->stamp_ns));
}

}  // namespace

absl::StatusOr<LaserDrive> ReadLaserDrive(const std::string& path) {
  LaserDrive drive;
  const auto survey = recording::SurveyDrive(path);
  if (!survey.ok()) return survey.status();
  const auto model = recording::MakeRobotModel(survey->transforms, 0);
  if (!model.ok()) return model.status();
  drive.calibration.base_from_laser = model->base_from_laser.value();
  auto reader = recording::Reader::Open(path);
  if (!reader.ok()) return reader.status();
  for (;;) {
    const auto message = (*reader)->Next();
    if (!message.ok()) return message.status();
    if (!*message) return drive;
    const recording::Message& content = **message;
    if (content.topic == recording::kLaserTopic) {
      foxglove::LaserScan scan;
      scan.ParseFromString(content.data);
      frames::LaserScan frame;
      frame.stamp_ns = *recording::NsFromTimestamp(scan.timestamp());
      frame.start_angle_rad = scan.start_angle();
      frame.angle_increment_rad =
          (scan.end_angle() - scan.start_angle()) / std::max(1, scan.ranges_size() - 1);
      for (const double range : scan.ranges()) {
        frame.range_m.push_back(std::isfinite(range) && range > 0.0
                                    ? static_cast<float>(range)
                                    : std::numeric_limits<float>::quiet_NaN());
      }
      drive.frames.emplace_back(std::move(frame));
    } else if (content.topic == recording::kOdometryTopic) {
      foxglove::Odometry odometry;
      odometry.ParseFromString(content.data);
      drive.frames.emplace_back(frames::Odometry{*recording::NsFromTimestamp(odometry.timestamp()),
                                                 ToPose2(odometry.pose())});
    }
  }
}

absl::StatusOr<LaserDrive> ReadCarmenDrive(const std::string& path) {
  std::string folder = (std::filesystem::temp_directory_path() / "laser_drive_XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr) return absl::InternalError("no temporary folder");
  const std::string recording = folder + "/drive.mcap";
  const auto converted = convert::Convert(path, recording);
  auto drive = converted.ok() ? ReadLaserDrive(recording) : converted.status();
  std::filesystem::remove_all(folder);
  return drive;
}

std::vector<StampedPose> ReadPoses(const std::string& path) {
  std::vector<StampedPose> poses;
  for (const auto& n : Numbers(path)) poses.push_back({Ns(n.at(0)), {n.at(1), n.at(2), n.at(3)}});
  return poses;
}

std::vector<PlanarRelation> ReadRelations(const std::string& path) {
  std::vector<PlanarRelation> relations;
  for (const auto& n : Numbers(path)) {
    relations.push_back({Ns(n.at(0)), Ns(n.at(1)), {n.at(2), n.at(3), n.at(7)}});
  }
  return relations;
}

// With planar poses as (complex position, unit complex heading).
RelationsError ErrorOfRelations(const std::vector<StampedPose>& path,
                                const std::vector<PlanarRelation>& relations) {
  std::vector<double> errors_m;
  double sum_rad = 0.0;
  for (const PlanarRelation& relation : relations) {
    const auto begin = At(path, relation.begin_ns), end = At(path, relation.end_ns);
    if (!begin || !end) continue;
    const Complex step = (Complex(end->x_m, end->y_m) - Complex(begin->x_m, begin->y_m)) *
                         std::polar(1.0, -begin->yaw_rad);
    errors_m.push_back(
        std::abs(step - Complex(relation.begin_from_end.x_m, relation.begin_from_end.y_m)));
    sum_rad += std::abs(
        std::arg(std::polar(1.0, end->yaw_rad - begin->yaw_rad - relation.begin_from_end.yaw_rad)));
  }
  RelationsError error;
  error.relations = static_cast<int>(errors_m.size());
  if (errors_m.empty()) return error;
  const double count = static_cast<double>(errors_m.size());
  for (const double e : errors_m) error.mean_m += e / count;
  double variance = 0.0;
  for (const double e : errors_m) variance += (e - error.mean_m) * (e - error.mean_m) / count;
  error.std_m = std::sqrt(variance);
  error.mean_deg = sum_rad / count * 180.0 / M_PI;
  return error;
}

PathError ErrorOfPath(const std::vector<StampedPose>& path, const std::vector<StampedPose>& truth) {
  std::vector<std::pair<Complex, Complex>> pairs;
  std::vector<double> turn_rad;
  for (const StampedPose& pose : truth) {
    const auto estimated = At(path, pose.stamp_ns);
    if (!estimated) continue;
    pairs.emplace_back(Complex(estimated->x_m, estimated->y_m),
                       Complex(pose.map_from_base.x_m, pose.map_from_base.y_m));
    turn_rad.push_back(pose.map_from_base.yaw_rad - estimated->yaw_rad);
  }
  PathError error;
  error.poses = static_cast<int>(pairs.size());
  if (pairs.empty()) return error;
  const double count = static_cast<double>(pairs.size());
  Complex mean_estimated, mean_true, correlation;
  for (const auto& [estimated, true_] : pairs) {
    mean_estimated += estimated / count;
    mean_true += true_ / count;
  }
  for (const auto& [estimated, true_] : pairs) {
    correlation += (true_ - mean_true) * std::conj(estimated - mean_estimated);
  }
  const Complex turn = std::polar(1.0, std::arg(correlation));
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const double distance_m =
        std::abs(turn * (pairs[i].first - mean_estimated) - (pairs[i].second - mean_true));
    error.mean_m += distance_m / count;
    error.max_m = std::max(error.max_m, distance_m);
    error.mean_deg +=
        std::abs(std::arg(std::polar(1.0, turn_rad[i]) / turn)) * 180.0 / M_PI / count;
  }
  return error;
}

}  // namespace soundmap::mapping
