#include "tests/mapping/recorded_drive.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>

#include "recording/drive.h"

namespace soundmap::mapping {
namespace {

frames::LidarScan ToLidarScan(const foxglove::PointCloud& cloud) {
  frames::LidarScan scan;
  scan.stamp_ns = *recording::NsFromTimestamp(cloud.timestamp());
  std::map<std::string, std::size_t> offset;
  for (const auto& field : cloud.fields()) offset[field.name()] = field.offset();
  for (std::size_t begin = 0; begin + cloud.point_stride() <= cloud.data().size();
       begin += cloud.point_stride()) {
    const char* bytes = cloud.data().data() + begin;
    Eigen::Vector3f point;
    std::memcpy(&point.x(), bytes + offset.at("x"), 4);
    std::memcpy(&point.y(), bytes + offset.at("y"), 4);
    std::memcpy(&point.z(), bytes + offset.at("z"), 4);
    if (!point.allFinite() || point.isZero()) continue;
    scan.point_in_lidar.push_back(point);
    if (offset.count("time_offset_ns") > 0) {
      std::uint32_t time_offset_ns;
      std::memcpy(&time_offset_ns, bytes + offset.at("time_offset_ns"), 4);
      scan.time_offset_ns.push_back(time_offset_ns);
    }
  }
  return scan;
}

geometry::Pose2 ToPose2(const foxglove::Pose& pose) {
  const auto& q = pose.orientation();
  return {pose.position().x(), pose.position().y(),
          std::atan2(2 * (q.w() * q.z() + q.x() * q.y()), 1 - 2 * (q.y() * q.y() + q.z() * q.z()))};
}

}  // namespace

absl::StatusOr<RecordedDrive> ReadDrive(const std::string& path) {
  RecordedDrive drive;
  const auto survey = recording::SurveyDrive(path);
  if (!survey.ok()) return survey.status();
  const auto model = recording::MakeRobotModel(survey->transforms, 0);
  if (!model.ok()) return model.status();
  drive.calibration.base_from_lidar = model->base_from_lidar.value();
  drive.calibration.base_from_laser = model->base_from_laser.value();

  auto reader = recording::Reader::Open(path);
  if (!reader.ok()) return reader.status();
  for (;;) {
    const auto message = (*reader)->Next();
    if (!message.ok()) return message.status();
    if (!*message) break;
    const recording::Message& content = **message;
    if (content.topic == recording::kLidarTopic) {
      foxglove::PointCloud cloud;
      cloud.ParseFromString(content.data);
      drive.frames.emplace_back(ToLidarScan(cloud));
    } else if (content.topic == recording::kOdometryTopic) {
      foxglove::Odometry odometry;
      odometry.ParseFromString(content.data);
      drive.frames.emplace_back(frames::Odometry{*recording::NsFromTimestamp(odometry.timestamp()),
                                                 ToPose2(odometry.pose())});
    } else if (content.topic == recording::kGroundTruthTopic) {
      foxglove::PoseInFrame pose;
      pose.ParseFromString(content.data);
      drive.truth.push_back({*recording::NsFromTimestamp(pose.timestamp()), ToPose2(pose.pose())});
    }
  }
  return drive;
}

geometry::Pose2 PoseAt(const std::vector<StampedPose>& poses, frames::TimeNs time_ns) {
  const auto after = std::lower_bound(
      poses.begin(), poses.end(), time_ns,
      [](const StampedPose& pose, frames::TimeNs wanted_ns) { return pose.stamp_ns < wanted_ns; });
  if (after == poses.begin()) return poses.front().map_from_base;
  if (after == poses.end()) return poses.back().map_from_base;
  const auto before = std::prev(after);
  return geometry::Interpolate(before->map_from_base, after->map_from_base,
                               static_cast<double>(time_ns - before->stamp_ns) /
                                   static_cast<double>(after->stamp_ns - before->stamp_ns));
}

}  // namespace soundmap::mapping
