#pragma once

#include <cstdint>
#include <string>

namespace soundmap::recording {

// One message of a recording: a serialized Foxglove protobuf message on a topic.
struct Message {
  std::string topic;
  std::string schema;    // e.g. "foxglove.RawAudio"; empty: the file names none
  std::string encoding;  // "protobuf" in recordings of this project
  std::int64_t log_time_ns = 0;
  std::int64_t publish_time_ns = 0;
  std::uint32_t sequence = 0;
  std::string data;
};

}  // namespace soundmap::recording
