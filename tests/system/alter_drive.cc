// alter_drive IN OUT CHANGE: a copy of a drive with one thing wrong with it, for the tests of the
// running programs.
//   no_audio            without /audio
//   no_lidar            without /lidar/points
//   until:T, from:T     only what comes before, or after, T seconds from the start
//   microphones:N       /tf_static places only mic_0 .. mic_N-1
//   nan_ranges          every LRF range is NaN
//   invalid_lidar       every LIDAR point is NaN or at the origin
//   backwards           from the middle on every stamp lies 3 s earlier: time runs backwards once
//   dead_microphone     the samples of channel 0 are 0
//   kidnapped:A:B       the robot is carried, unseen, from where it was A seconds after the start
//   to
//                       where it was B seconds after it: nothing in between, times and odometry go
//                       on

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <iostream>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "foxglove/FrameTransforms.pb.h"
#include "foxglove/LaserScan.pb.h"
#include "foxglove/Odometry.pb.h"
#include "foxglove/PointCloud.pb.h"
#include "foxglove/PoseInFrame.pb.h"
#include "foxglove/RawAudio.pb.h"
#include "recording/foxglove_messages.h"
#include "recording/reader.h"
#include "recording/writer.h"

namespace soundmap {
namespace {

using recording::Message;

constexpr std::int64_t kBackwards_ns = 3'000'000'000;

template <typename Proto>
void Change(Message& message, const std::function<void(Proto&)>& change) {
  Proto proto;
  if (!proto.ParseFromString(message.data)) std::abort();
  change(proto);
  message.data = proto.SerializeAsString();
}

template <typename Proto>
void SetStampBack(Message& message, std::int64_t by_ns) {
  Change<Proto>(message, [by_ns](Proto& proto) {
    const auto stamp_ns = recording::NsFromTimestamp(proto.timestamp());
    *proto.mutable_timestamp() = recording::TimestampFromNs(*stamp_ns - by_ns);
  });
}

void SetBack(Message& message, std::int64_t by_ns) {
  message.log_time_ns -= by_ns;
  if (message.topic == recording::kAudioTopic) SetStampBack<foxglove::RawAudio>(message, by_ns);
  if (message.topic == recording::kLidarTopic) SetStampBack<foxglove::PointCloud>(message, by_ns);
  if (message.topic == recording::kLaserTopic) SetStampBack<foxglove::LaserScan>(message, by_ns);
  if (message.topic == recording::kOdometryTopic) SetStampBack<foxglove::Odometry>(message, by_ns);
  if (message.topic == recording::kGroundTruthTopic) {
    SetStampBack<foxglove::PoseInFrame>(message, by_ns);
  }
}

struct Planar {
  double x_m, y_m, yaw_rad;
};

Planar PlanarOf(const foxglove::Odometry& odometry) {
  const foxglove::Quaternion& q = odometry.pose().orientation();
  return {odometry.pose().position().x(), odometry.pose().position().y(),
          2.0 * std::atan2(q.z(), q.w())};
}

// The drive with the part between two times cut out and the odometry joined.
std::vector<Message> Kidnap(const std::vector<Message>& messages, double begin_s, double end_s) {
  const std::int64_t start_ns = messages.front().log_time_ns;
  const auto begin_ns = start_ns + static_cast<std::int64_t>(begin_s * 1e9);
  const auto end_ns = start_ns + static_cast<std::int64_t>(end_s * 1e9);
  std::vector<Message> joined;
  Planar before{};
  std::optional<Planar> after;
  for (Message message : messages) {
    const bool placed = message.topic == recording::kTransformsTopic;
    if (!placed && message.log_time_ns >= begin_ns && message.log_time_ns < end_ns) continue;
    foxglove::Odometry odometry;
    const bool is_odometry =
        message.topic == recording::kOdometryTopic && odometry.ParseFromString(message.data);
    if (is_odometry && message.log_time_ns < begin_ns) before = PlanarOf(odometry);
    if (is_odometry && message.log_time_ns >= end_ns) {
      const Planar now = PlanarOf(odometry);
      if (!after) after = now;
      const double turn = before.yaw_rad - after->yaw_rad;
      const double dx = now.x_m - after->x_m;
      const double dy = now.y_m - after->y_m;
      auto& pose = *odometry.mutable_pose();
      pose.mutable_position()->set_x(before.x_m + std::cos(turn) * dx - std::sin(turn) * dy);
      pose.mutable_position()->set_y(before.y_m + std::sin(turn) * dx + std::cos(turn) * dy);
      pose.mutable_orientation()->set_z(std::sin((now.yaw_rad + turn) / 2.0));
      pose.mutable_orientation()->set_w(std::cos((now.yaw_rad + turn) / 2.0));
      message.data = odometry.SerializeAsString();
    }
    if (!placed && message.log_time_ns >= end_ns) SetBack(message, end_ns - begin_ns);
    joined.push_back(std::move(message));
  }
  return joined;
}

void KeepMicrophones(Message& message, int count) {
  Change<foxglove::FrameTransforms>(message, [count](foxglove::FrameTransforms& transforms) {
    foxglove::FrameTransforms kept;
    for (const foxglove::FrameTransform& transform : transforms.transforms()) {
      const std::string& child = transform.child_frame_id();
      if (child.rfind("mic_", 0) == 0 && child != "mic_array" &&
          std::atoi(child.c_str() + 4) >= count) {
        continue;
      }
      *kept.add_transforms() = transform;
    }
    transforms = kept;
  });
}

void SpoilRanges(foxglove::LaserScan& scan) {
  for (double& range_m : *scan.mutable_ranges()) {
    range_m = std::numeric_limits<double>::quiet_NaN();
  }
}

void SpoilPoints(foxglove::PointCloud& cloud) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  std::string& data = *cloud.mutable_data();
  for (std::size_t point = 0; point * cloud.point_stride() < data.size(); ++point) {
    float xyz[3] = {0.0f, 0.0f, 0.0f};
    if (point % 2 == 0) xyz[0] = nan;
    std::memcpy(data.data() + point * cloud.point_stride(), xyz, sizeof(xyz));
  }
}

void Silence(foxglove::RawAudio& audio) {
  std::string& data = *audio.mutable_data();
  const std::size_t stride = 2 * audio.number_of_channels();
  for (std::size_t sample = 0; sample < data.size(); sample += stride) {
    data[sample] = data[sample + 1] = 0;
  }
}

int Main(const std::string& in, const std::string& out, const std::string& change) {
  auto reader = recording::Reader::Open(in);
  auto writer = recording::Writer::Create(out, {});
  if (!reader.ok() || !writer.ok()) {
    std::cerr << reader.status() << ' ' << writer.status() << '\n';
    return 1;
  }
  std::vector<Message> messages;
  while (true) {
    auto message = (*reader)->Next();
    if (!message.ok()) {
      std::cerr << message.status() << '\n';
      return 1;
    }
    if (!message->has_value()) break;
    messages.push_back(**std::move(message));
  }
  const std::int64_t start_ns = messages.front().log_time_ns;
  double until_s = std::numeric_limits<double>::infinity();
  double from_s = 0.0;
  std::sscanf(change.c_str(), "until:%lf", &until_s);
  std::sscanf(change.c_str(), "from:%lf", &from_s);
  double begin_s = 0.0;
  double end_s = 0.0;
  if (std::sscanf(change.c_str(), "kidnapped:%lf:%lf", &begin_s, &end_s) == 2) {
    messages = Kidnap(messages, begin_s, end_s);
  }
  std::uint32_t sequence = 0;
  for (std::size_t i = 0; i < messages.size(); ++i) {
    Message& message = messages[i];
    const bool second_half = i > messages.size() / 2;
    if (change == "no_audio" && message.topic == recording::kAudioTopic) continue;
    if (change == "no_lidar" && message.topic == recording::kLidarTopic) continue;
    const double time_s = 1e-9 * static_cast<double>(message.log_time_ns - start_ns);
    if (message.topic != recording::kTransformsTopic && (time_s >= until_s || time_s < from_s)) {
      continue;
    }
    if (change.rfind("microphones:", 0) == 0 && message.topic == recording::kTransformsTopic) {
      KeepMicrophones(message, std::atoi(change.c_str() + std::strlen("microphones:")));
    }
    if (change == "nan_ranges" && message.topic == recording::kLaserTopic) {
      Change<foxglove::LaserScan>(message, SpoilRanges);
    }
    if (change == "invalid_lidar" && message.topic == recording::kLidarTopic) {
      Change<foxglove::PointCloud>(message, SpoilPoints);
    }
    if (change == "dead_microphone" && message.topic == recording::kAudioTopic) {
      Change<foxglove::RawAudio>(message, Silence);
    }
    if (change == "backwards" && second_half) SetBack(message, kBackwards_ns);
    const absl::Status written = (*writer)->Write(message.topic, message.schema,
                                                  message.log_time_ns, sequence++, message.data);
    if (!written.ok()) {
      std::cerr << written << '\n';
      return 1;
    }
  }
  return (*writer)->Close().ok() ? 0 : 1;
}

}  // namespace
}  // namespace soundmap

int main(int argc, char** argv) {
  if (argc != 4) {
    std::cerr << "usage: alter_drive IN OUT CHANGE\n";
    return 2;
  }
  return soundmap::Main(argv[1], argv[2], argv[3]);
}
