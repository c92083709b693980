#include "recording/drive.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"

namespace soundmap::recording {
namespace {

constexpr std::size_t kMaxFrames = 4096;
constexpr double kUnitTolerance = 1e-3;

// None: a number is not finite, or the rotation is not a unit quaternion.
std::optional<Eigen::Isometry3d> IsometryFrom(const foxglove::Vector3& translation,
                                              const foxglove::Quaternion& rotation) {
  const Eigen::Vector3d position(translation.x(), translation.y(), translation.z());
  const Eigen::Quaterniond quaternion(rotation.w(), rotation.x(), rotation.y(), rotation.z());
  if (!position.allFinite() || !(std::abs(quaternion.norm() - 1.0) <= kUnitTolerance)) {
    return std::nullopt;
  }
  Eigen::Isometry3d isometry = Eigen::Isometry3d::Identity();
  isometry.linear() = quaternion.normalized().toRotationMatrix();
  isometry.translation() = position;
  return isometry;
}

std::string MicrophoneFrame(int channel) { return absl::StrCat("mic_", channel); }

absl::Status CheckSchema(const Message& message, std::string_view schema) {
  if (message.schema == schema && message.encoding == "protobuf") return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("the topic ", message.topic, " carries ",
                                                 message.schema, " as '", message.encoding, "'; ",
                                                 std::string(schema), " as 'protobuf' is needed"));
}

absl::Status SurveyAudio(const Message& message, DriveSurvey& survey) {
  foxglove::RawAudio audio;
  if (!audio.ParseFromString(message.data)) {
    return absl::InvalidArgumentError(
        absl::StrCat("a message on ", message.topic, " is not a foxglove.RawAudio"));
  }
  if (audio.format() != "pcm-s16") {
    return absl::InvalidArgumentError(absl::StrCat("the audio on ", message.topic,
                                                   " has the format '", audio.format(),
                                                   "'; 'pcm-s16' is needed"));
  }
  constexpr std::uint32_t kMaxInt = std::numeric_limits<int>::max();
  if (audio.sample_rate() < 1 || audio.sample_rate() > kMaxInt) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the audio on ", message.topic, " has a sample rate of ", audio.sample_rate(), " Hz"));
  }
  if (audio.number_of_channels() < 1 || audio.number_of_channels() > kMaxFrames) {
    return absl::InvalidArgumentError(absl::StrCat("the audio on ", message.topic, " has ",
                                                   audio.number_of_channels(), " channels"));
  }
  survey.audio_sample_rate_hz = static_cast<int>(audio.sample_rate());
  survey.audio_channels = static_cast<int>(audio.number_of_channels());
  return absl::OkStatus();
}

absl::Status SurveyTransforms(const Message& message, TransformTree& tree) {
  foxglove::FrameTransforms transforms;
  if (!transforms.ParseFromString(message.data)) {
    return absl::InvalidArgumentError(
        absl::StrCat("a message on ", message.topic, " is not a foxglove.FrameTransforms"));
  }
  for (const foxglove::FrameTransform& transform : transforms.transforms()) {
    if (absl::Status status = tree.Add(transform); !status.ok()) return status;
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status TransformTree::Add(const foxglove::FrameTransform& parent_from_child) {
  const std::string& parent = parent_from_child.parent_frame_id();
  const std::string& child = parent_from_child.child_frame_id();
  const auto invalid = [&](std::string_view what) {
    return absl::InvalidArgumentError(
        absl::StrCat("the transform from '", parent, "' to '", child, "' ", std::string(what)));
  };
  if (parent.empty() || child.empty()) return invalid("lacks the name of a frame");
  const std::optional<Eigen::Isometry3d> isometry =
      IsometryFrom(parent_from_child.translation(), parent_from_child.rotation());
  if (!isometry) return invalid("has a number that is not finite or a rotation that is none");
  if (const auto known = link_of_child_.find(child); known != link_of_child_.end()) {
    if (known->second.parent == parent &&
        known->second.parent_from_child.matrix() == isometry->matrix()) {
      return absl::OkStatus();
    }
    return invalid("contradicts an earlier one of the same frame");
  }
  if (link_of_child_.size() >= kMaxFrames) return invalid("is one too many");
  if (FindRoot(parent).frame == child) return invalid("closes a loop");
  link_of_child_.emplace(child, Link{parent, *isometry});
  return absl::OkStatus();
}

TransformTree::Root TransformTree::FindRoot(const std::string& frame) const {
  Root root{frame, Eigen::Isometry3d::Identity()};
  for (auto link = link_of_child_.find(frame); link != link_of_child_.end();
       link = link_of_child_.find(root.frame)) {
    root.root_from_frame = link->second.parent_from_child * root.root_from_frame;
    root.frame = link->second.parent;
  }
  return root;
}

std::optional<Eigen::Isometry3d> TransformTree::Find(const std::string& target,
                                                     const std::string& source) const {
  const Root from_target = FindRoot(target);
  const Root from_source = FindRoot(source);
  if (from_target.frame != from_source.frame) return std::nullopt;
  return from_target.root_from_frame.inverse() * from_source.root_from_frame;
}

absl::StatusOr<RobotModel> MakeRobotModel(const TransformTree& transforms, int audio_channels) {
  RobotModel model;
  model.base_from_array = transforms.Find("base_link", "mic_array");
  model.base_from_lidar = transforms.Find("base_link", "lidar");
  model.base_from_laser = transforms.Find("base_link", "laser");
  if (audio_channels == 0) return model;

  int missing = 0;
  std::string first_missing;
  for (int channel = 0; channel < audio_channels; ++channel) {
    const std::optional<Eigen::Isometry3d> array_from_mic =
        transforms.Find("mic_array", MicrophoneFrame(channel));
    if (array_from_mic) {
      model.mic_in_array_m.push_back(array_from_mic->translation());
    } else if (missing++ == 0) {
      first_missing = MicrophoneFrame(channel);
    }
  }
  if (missing == audio_channels) {
    return absl::InvalidArgumentError(
        absl::StrCat("the drive places no microphone: its audio has ", audio_channels,
                     " channels, and each needs its frame, ", MicrophoneFrame(0), " .. ",
                     MicrophoneFrame(audio_channels - 1), ", under mic_array"));
  }
  if (missing > 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the drive places only ", audio_channels - missing, " microphones for ", audio_channels,
        " audio channels: the frame ", first_missing, " under mic_array is missing"));
  }
  if (transforms.Find("mic_array", MicrophoneFrame(audio_channels))) {
    return absl::InvalidArgumentError(
        absl::StrCat("the drive places more microphones than its audio has channels, ",
                     audio_channels, ": there is a frame ", MicrophoneFrame(audio_channels)));
  }
  if (!model.base_from_array) {
    return absl::InvalidArgumentError(
        "the drive does not say where its microphones are: no transform connects base_link and "
        "mic_array");
  }
  return model;
}

absl::StatusOr<DriveSurvey> SurveyDrive(const std::string& path, const DriveTopics& topics,
                                        const ReaderLimits& limits) {
  absl::StatusOr<std::unique_ptr<Reader>> reader = Reader::Open(path, limits);
  if (!reader.ok()) return reader.status();
  DriveSurvey survey;
  while (true) {
    const absl::StatusOr<std::optional<Message>> next = (*reader)->Next();
    if (!next.ok()) {
      survey.damage = next.status();
      return survey;
    }
    if (!*next) return survey;
    const Message& message = **next;
    absl::Status status;
    bool sensor = true;
    if (message.topic == topics.audio) {
      status = CheckSchema(message, "foxglove.RawAudio");
      if (status.ok() && survey.audio_count++ == 0) status = SurveyAudio(message, survey);
    } else if (message.topic == topics.lidar) {
      status = CheckSchema(message, "foxglove.PointCloud");
      ++survey.lidar_count;
    } else if (message.topic == topics.laser) {
      status = CheckSchema(message, "foxglove.LaserScan");
      ++survey.laser_count;
    } else if (message.topic == topics.odometry) {
      status = CheckSchema(message, "foxglove.Odometry");
      ++survey.odometry_count;
    } else {
      sensor = false;
      if (message.topic == topics.transforms) {
        status = CheckSchema(message, "foxglove.FrameTransforms");
        if (status.ok()) status = SurveyTransforms(message, survey.transforms);
      }
    }
    if (!status.ok()) {
      return absl::Status(status.code(), absl::StrCat("'", path, "': ", status.message()));
    }
    if (!sensor) continue;
    const bool first = survey.sensor_count() == 1;
    survey.first_log_time_ns =
        first ? message.log_time_ns : std::min(survey.first_log_time_ns, message.log_time_ns);
    survey.last_log_time_ns =
        first ? message.log_time_ns : std::max(survey.last_log_time_ns, message.log_time_ns);
  }
}

absl::StatusOr<std::vector<StampedPose>> ReadGroundTruth(const std::string& path) {
  absl::StatusOr<std::unique_ptr<Reader>> reader = Reader::Open(path);
  if (!reader.ok()) return reader.status();
  std::vector<StampedPose> poses;
  while (true) {
    const absl::StatusOr<std::optional<Message>> next = (*reader)->Next();
    if (!next.ok()) return next.status();
    if (!*next) return poses;
    const Message& message = **next;
    if (message.topic != kGroundTruthTopic) continue;
    if (absl::Status status = CheckSchema(message, "foxglove.PoseInFrame"); !status.ok()) {
      return status;
    }
    foxglove::PoseInFrame pose;
    const bool parsed = pose.ParseFromString(message.data);
    const std::optional<std::int64_t> time_ns = NsFromTimestamp(pose.timestamp());
    const std::optional<Eigen::Isometry3d> map_from_base =
        IsometryFrom(pose.pose().position(), pose.pose().orientation());
    if (!parsed || !time_ns || !map_from_base) {
      return absl::InvalidArgumentError(
          absl::StrCat("'", path, "': pose ", poses.size(), " on ", message.topic, " is not one"));
    }
    poses.push_back({*time_ns, *map_from_base});
  }
}

}  // namespace soundmap::recording
