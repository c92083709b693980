#pragma once

#include <cstdint>
#include <string_view>

#include "soundmap/v1/ingest_service.pb.h"
#include "sources/frame_source.h"

namespace soundmap::uplink {

// Standard CRC-32C of `bytes` appended to what gave `crc`; 0 to begin.
std::uint32_t ExtendCrc32c(std::uint32_t crc, std::string_view bytes);

// A sensor message as it travels.
struct OutgoingFrame {
  sources::SensorFrame frame;  // its payload coded
  v1::Coding coding = v1::CODING_UNSPECIFIED;
  std::int64_t message_bytes = 0;  // before coding

  std::int64_t payload_bytes() const { return static_cast<std::int64_t>(frame.payload.size()); }
};

// One chunk in the making: frames of consecutive offsets, or one part of a frame that is larger
// than a chunk.
class ChunkBuilder {
 public:
  explicit ChunkBuilder(std::int64_t first_offset);

  void Add(const OutgoingFrame& frame);
  // Bytes [part * part_bytes, (part + 1) * part_bytes) of the payload; the chunk takes nothing
  // else.
  void AddPart(const OutgoingFrame& frame, std::int64_t part_bytes, std::uint32_t part);

  std::int64_t payload_bytes() const { return payload_bytes_; }
  // What the chunk takes of the credit: its messages' bytes before coding.
  std::int64_t credit_bytes() const { return credit_bytes_; }
  int frame_count() const { return request_.chunk().frames_size(); }
  // With its checksum.
  const v1::IngestRequest& Finish();

 private:
  v1::Frame& AddFrame(const OutgoingFrame& frame, std::string_view payload);

  v1::IngestRequest request_;
  std::int64_t payload_bytes_ = 0;
  std::int64_t credit_bytes_ = 0;
  std::uint32_t crc_ = 0;
};

}  // namespace soundmap::uplink
