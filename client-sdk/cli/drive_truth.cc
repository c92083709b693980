#include "cli/drive_truth.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "recording/drive.h"
#include "recording/foxglove_messages.h"
#include "recording/reader.h"

namespace soundmap::cli {
namespace {

// Of a pose in space what the flat floor keeps.
std::optional<Pose2> OnFloor(const foxglove::Pose& pose) {
  const auto& q = pose.orientation();
  const double norm = std::sqrt(q.x() * q.x() + q.y() * q.y() + q.z() * q.z() + q.w() * q.w());
  if (!std::isfinite(pose.position().x()) || !std::isfinite(pose.position().y()) ||
      !std::isfinite(norm) || norm == 0.0) {
    return std::nullopt;
  }
  return Pose2{pose.position().x(), pose.position().y(),
               std::atan2(2.0 * (q.w() * q.z() + q.x() * q.y()),
                          q.w() * q.w() + q.x() * q.x() - q.y() * q.y() - q.z() * q.z())};
}

}  // namespace

absl::StatusOr<DriveTruth> ReadDriveTruth(const std::string& path) {
  auto reader = recording::Reader::Open(path);
  if (!reader.ok()) return reader.status();
  const auto error = [&path](absl::string_view what) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", what));
  };
  DriveTruth truth;
  std::optional<std::int64_t> start_ns;
  recording::TransformTree tree;
  for (;;) {
    const auto message = (*reader)->Next();
    if (!message.ok()) {
      truth.warning = std::string(message.status().message());
      break;
    }
    if (!message->has_value()) break;
    const recording::Message& m = **message;
    start_ns = std::min(start_ns.value_or(m.log_time_ns), m.log_time_ns);
    if (m.topic == recording::kTransformsTopic) {
      foxglove::FrameTransforms transforms;
      if (!transforms.ParseFromString(m.data)) return error("/tf_static cannot be read");
      for (const auto& transform : transforms.transforms()) {
        const absl::Status added = tree.Add(transform);
        if (!added.ok()) return error(added.message());
      }
    } else if (m.topic == recording::kGroundTruthTopic) {
      foxglove::PoseInFrame pose;
      if (!pose.ParseFromString(m.data)) return error("/ground_truth/pose cannot be read");
      if (pose.frame_id() != "map") return error("/ground_truth/pose is not in the frame map");
      const auto time_ns = recording::NsFromTimestamp(pose.timestamp());
      const auto map_from_base = OnFloor(pose.pose());
      if (!time_ns || !map_from_base) return error("a pose of /ground_truth/pose is not finite");
      truth.map_from_base.push_back({*time_ns, *map_from_base});
    }
  }
  if (!start_ns) {
    return error(truth.warning.empty() ? absl::string_view("there is no message in this recording")
                                       : absl::string_view(truth.warning));
  }
  truth.start_ns = *start_ns;
  if (const auto base_from_array = tree.Find("base_link", "mic_array")) {
    const Eigen::Vector3d& array_in_base = base_from_array->translation();
    truth.array_in_base_m = Vector3{array_in_base.x(), array_in_base.y(), array_in_base.z()};
  }
  std::stable_sort(
      truth.map_from_base.begin(), truth.map_from_base.end(),
      [](const StampedPose& a, const StampedPose& b) { return a.time_ns < b.time_ns; });
  return truth;
}

}  // namespace soundmap::cli
