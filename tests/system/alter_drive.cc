// alter_drive IN OUT CHANGE: a copy of a drive with one thing wrong with it, for the tests of the
// running programs.
//   no_audio            without /audio
//   microphones:N       /tf_static places only mic_0 .. mic_N-1
//   nan_ranges          every LRF range is NaN
//   invalid_lidar       every LIDAR point is NaN or at the origin
//   backwards           from the middle on every stamp lies 3 s earlier: time runs backwards once
//   dead_microphone     the samples of channel 0 are 0

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <iostream>
#include <limits>
#include <string>
#include <vector>

#include "foxglove/FrameTransforms.pb.h"
#include "foxglove/LaserScan.pb.h"
#include "foxglove/Odometry.pb.h"
#include "foxglove/PointCloud.pb.h"
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
void SetBack(Message& message) {
  Change<Proto>(message, [](Proto& proto) {
    const auto stamp_ns = recording::NsFromTimestamp(proto.timestamp());
    *proto.mutable_timestamp() = recording::TimestampFromNs(*stamp_ns - kBackwards_ns);
  });
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
  std::uint32_t sequence = 0;
  for (std::size_t i = 0; i < messages.size(); ++i) {
    Message& message = messages[i];
    const bool second_half = i > messages.size() / 2;
    if (change == "no_audio" && message.topic == recording::kAudioTopic) continue;
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
    if (change == "backwards" && second_half) {
      message.log_time_ns -= kBackwards_ns;
      if (message.topic == recording::kAudioTopic) SetBack<foxglove::RawAudio>(message);
      if (message.topic == recording::kLidarTopic) SetBack<foxglove::PointCloud>(message);
      if (message.topic == recording::kLaserTopic) SetBack<foxglove::LaserScan>(message);
      if (message.topic == recording::kOdometryTopic) SetBack<foxglove::Odometry>(message);
    }
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
