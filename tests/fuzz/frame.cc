#include <google/protobuf/stubs/logging.h>

#include <cmath>
#include <span>

#include "api/decode_message.h"
#include "foxglove/KeyValuePair.pb.h"
#include "recording/foxglove_messages.h"
#include "tests/fuzz/target.h"

namespace soundmap::fuzz {
namespace {

constexpr const char* kSchemas[] = {"foxglove.RawAudio", "foxglove.PointCloud",
                                    "foxglove.LaserScan", "foxglove.Odometry",
                                    "foxglove.KeyValuePair"};

}  // namespace

std::vector<std::string> Seeds() {
  google::protobuf::SetLogHandler(nullptr);  // as the server's
  const std::int16_t samples[] = {1, -2, 3, -4, 5, -6};
  std::vector<std::string> seeds = {
      std::string(1, '\0') +
      recording::MakeRawAudio(1'700'000'000'000'000'000, 16000, 2, samples).SerializeAsString()};
  foxglove::PointCloud cloud;
  cloud.mutable_timestamp()->set_seconds(1'700'000'000);
  cloud.set_frame_id("lidar");
  cloud.set_point_stride(16);
  for (const auto& [name, offset] : {std::pair("x", 0), {"y", 4}, {"z", 8}}) {
    auto& field = *cloud.add_fields();
    field.set_name(name);
    field.set_offset(static_cast<std::uint32_t>(offset));
    field.set_type(foxglove::PackedElementField::FLOAT32);
  }
  auto& time = *cloud.add_fields();
  time.set_name("time_offset_ns");
  time.set_offset(12);
  time.set_type(foxglove::PackedElementField::UINT32);
  cloud.set_data(std::string(160, '\x40'));
  seeds.push_back(std::string(1, '\1') + cloud.SerializeAsString());
  foxglove::LaserScan scan;
  scan.mutable_timestamp()->set_seconds(1'700'000'000);
  scan.set_start_angle(-1.0);
  scan.set_end_angle(1.0);
  for (int i = 0; i < 20; ++i) scan.add_ranges(0.5 * i);
  seeds.push_back(std::string(1, '\2') + scan.SerializeAsString());
  foxglove::Odometry odometry;
  odometry.mutable_timestamp()->set_seconds(1'700'000'000);
  odometry.mutable_pose()->mutable_position()->set_x(1.0);
  odometry.mutable_pose()->mutable_orientation()->set_w(1.0);
  seeds.push_back(std::string(1, '\3') + odometry.SerializeAsString());
  foxglove::KeyValuePair gap;
  gap.set_key("gap");
  gap.set_value(R"({"frames": 5, "from_ns": 1, "to_ns": 2, "reason": "the spool was full"})");
  seeds.push_back(std::string(1, '\4') + gap.SerializeAsString());
  return seeds;
}

void Decode(std::string_view bytes) {
  if (bytes.empty()) return;
  frames::Calibration calibration;
  calibration.mic_in_array_m = {{0.0, 0.0, 0.0}, {0.1, 0.0, 0.0}};
  calibration.audio_sample_rate_hz = 16000;
  recording::Message message;
  message.schema = kSchemas[static_cast<unsigned char>(bytes[0]) % std::size(kSchemas)];
  message.data = bytes.substr(1);
  const auto decoded = api::DecodeMessage(message, calibration);
  if (!decoded.ok()) return;
  if (const auto* gap = std::get_if<pipeline::Gap>(&*decoded)) {
    Require(gap->frames > 0 && gap->from_ns >= 0 && gap->to_ns >= 0);
  }
}

}  // namespace soundmap::fuzz
