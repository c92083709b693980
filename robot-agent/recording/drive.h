#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "foxglove/FrameTransforms.pb.h"
#include "recording/foxglove_messages.h"
#include "recording/reader.h"

// What a drive says beside its sensor messages: where the sensors are, what there is of each, where
// the robot truly was.
namespace soundmap::recording {

// Rigid transforms between named frames, added in any order; each frame has one parent.
class TransformTree {
 public:
  // InvalidArgument: a name is missing, a number is not finite, the rotation is not a unit
  // quaternion (within 1e-3), the child has been placed elsewhere before, the frames form a loop,
  // or there are too many.
  absl::Status Add(const foxglove::FrameTransform& parent_from_child);

  // target_from_source, along chains up and down; none where no chain connects the two.
  std::optional<Eigen::Isometry3d> Find(const std::string& target, const std::string& source) const;

 private:
  struct Link {
    std::string parent;
    Eigen::Isometry3d parent_from_child;
  };
  struct Root {
    std::string frame;
    Eigen::Isometry3d root_from_frame;
  };
  Root FindRoot(const std::string& frame) const;

  std::map<std::string, Link> link_of_child_;
};

struct RobotModel {
  std::optional<Eigen::Isometry3d> base_from_array;  // none: the drive does not say
  std::optional<Eigen::Isometry3d> base_from_lidar;
  std::optional<Eigen::Isometry3d> base_from_laser;
  std::vector<Eigen::Vector3d> mic_in_array_m;  // in channel order
};

// base_link -> mic_array, lidar, laser, and microphones mic_0 .. mic_<N-1> under mic_array, one for
// each audio channel; without audio (0) none. InvalidArgument: a microphone or, with audio, the
// array is missing, or there are more microphones than channels.
absl::StatusOr<RobotModel> MakeRobotModel(const TransformTree& transforms, int audio_channels);

// The topic of each kind of message.
struct DriveTopics {
  std::string transforms{kTransformsTopic};
  std::string audio{kAudioTopic};
  std::string lidar{kLidarTopic};
  std::string laser{kLaserTopic};
  std::string odometry{kOdometryTopic};
};

struct DriveSurvey {
  std::int64_t audio_count = 0;  // messages
  std::int64_t lidar_count = 0;
  std::int64_t laser_count = 0;
  std::int64_t odometry_count = 0;
  std::int64_t first_log_time_ns = 0;  // of these messages
  std::int64_t last_log_time_ns = 0;
  int audio_sample_rate_hz = 0;  // of the first audio message; 0: no audio
  int audio_channels = 0;
  TransformTree transforms;
  absl::Status damage;  // DataLoss: the survey holds up to there

  std::int64_t sensor_count() const {
    return audio_count + lidar_count + laser_count + odometry_count;
  }
};

// Reads the whole drive once; transforms may stand anywhere in it. InvalidArgument: a topic carries
// another schema than the format says, the first audio message cannot be used, or the transforms
// contradict each other.
absl::StatusOr<DriveSurvey> SurveyDrive(const std::string& path, const DriveTopics& topics = {},
                                        const ReaderLimits& limits = {});

struct StampedPose {
  std::int64_t time_ns = 0;
  Eigen::Isometry3d map_from_base = Eigen::Isometry3d::Identity();
};

// /ground_truth/pose in the order of the file; empty if there is none. DataLoss if the file is
// damaged.
absl::StatusOr<std::vector<StampedPose>> ReadGroundTruth(const std::string& path);

}  // namespace soundmap::recording
