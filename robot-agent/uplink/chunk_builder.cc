#include "uplink/chunk_builder.h"

#include <isa-l/crc.h>

#include <string>

namespace soundmap::uplink {
namespace {

v1::Sensor ToProto(sources::Sensor sensor) {
  switch (sensor) {
    case sources::Sensor::kAudio:
      return v1::SENSOR_AUDIO;
    case sources::Sensor::kLidar:
      return v1::SENSOR_LIDAR;
    case sources::Sensor::kLaser:
      return v1::SENSOR_LASER;
    case sources::Sensor::kOdometry:
      return v1::SENSOR_ODOMETRY;
    case sources::Sensor::kGap:
      return v1::SENSOR_GAP;
  }
  return v1::SENSOR_UNSPECIFIED;
}

}  // namespace

std::uint32_t ExtendCrc32c(std::uint32_t crc, std::string_view bytes) {
  // ISA-L takes and gives the bare register and does not write to the buffer.
  auto* data = reinterpret_cast<unsigned char*>(const_cast<char*>(bytes.data()));
  return ~crc32_iscsi(data, static_cast<int>(bytes.size()), ~crc);
}

ChunkBuilder::ChunkBuilder(std::int64_t first_offset) {
  request_.mutable_chunk()->set_first_offset(first_offset);
}

v1::Frame& ChunkBuilder::AddFrame(const OutgoingFrame& frame, std::string_view payload) {
  v1::Frame& out = *request_.mutable_chunk()->add_frames();
  out.set_sensor(ToProto(frame.frame.sensor));
  out.set_log_time_ns(static_cast<std::uint64_t>(frame.frame.log_time_ns));
  if (frame.coding != v1::CODING_UNSPECIFIED) {
    out.set_coding(frame.coding);
    out.set_message_bytes(static_cast<std::uint32_t>(frame.message_bytes));
  }
  out.set_payload(payload.data(), payload.size());
  payload_bytes_ += static_cast<std::int64_t>(payload.size());
  crc_ = ExtendCrc32c(crc_, payload);
  return out;
}

void ChunkBuilder::Add(const OutgoingFrame& frame) {
  AddFrame(frame, frame.frame.payload);
  credit_bytes_ += frame.message_bytes;
}

void ChunkBuilder::AddPart(const OutgoingFrame& frame, std::int64_t part_bytes,
                           std::uint32_t part) {
  const std::string_view payload = frame.frame.payload;
  const auto bytes = static_cast<std::size_t>(part_bytes);
  v1::Frame& out = AddFrame(frame, payload.substr(part * bytes, bytes));
  const auto parts = static_cast<std::uint32_t>((payload.size() + bytes - 1) / bytes);
  out.set_part(part);
  out.set_part_count(parts);
  credit_bytes_ += frame.coding == v1::CODING_UNSPECIFIED
                       ? static_cast<std::int64_t>(out.payload().size())
                       : (frame.message_bytes + parts - 1) / parts;
}

const v1::IngestRequest& ChunkBuilder::Finish() {
  request_.mutable_chunk()->set_crc32c(crc_);
  return request_;
}

}  // namespace soundmap::uplink
