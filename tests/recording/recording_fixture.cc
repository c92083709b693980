// Writes and shows recordings for the comparison with another implementation of MCAP.
//   recording_fixture write FILE none|lz4|zstd chunked|plain summary|bare   writes messages and
//   prints them as JSON recording_fixture show FILE prints the messages of a file as JSON

#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "recording/foxglove_messages.h"
#include "recording/reader.h"
#include "recording/writer.h"

namespace {

using namespace soundmap::recording;

std::string Hex(const std::string& bytes) {
  constexpr char kDigits[] = "0123456789abcdef";
  std::string hex;
  for (const char c : bytes) {
    hex.push_back(kDigits[static_cast<unsigned char>(c) >> 4]);
    hex.push_back(kDigits[static_cast<unsigned char>(c) & 15]);
  }
  return hex;
}

nlohmann::json Show(const Message& message) {
  return {{"topic", message.topic},
          {"schema", message.schema},
          {"encoding", message.encoding},
          {"log_time", std::to_string(message.log_time_ns)},
          {"publish_time", std::to_string(message.publish_time_ns)},
          {"sequence", message.sequence},
          {"data", Hex(message.data)}};
}

int Fail(const absl::Status& status) {
  std::cerr << status << "\n";
  return 1;
}

int Write(const std::string& path, const WriterOptions& options) {
  auto writer = Writer::Create(path, options);
  if (!writer.ok()) return Fail(writer.status());
  nlohmann::json shown = nlohmann::json::array();
  for (std::uint32_t i = 0; i < 300; ++i) {
    const std::int64_t time_ns = 1'700'000'000'000'000'000 + i * 10'000'000;
    const std::vector<std::int16_t> samples(160, static_cast<std::int16_t>(i * 37));
    const std::vector<double> range_m(20, 0.01 * i);
    Message message{.topic = i % 3 == 0 ? "/audio" : "/scan",
                    .schema = i % 3 == 0 ? "foxglove.RawAudio" : "foxglove.LaserScan",
                    .encoding = "protobuf",
                    .log_time_ns = time_ns,
                    .publish_time_ns = time_ns,
                    .sequence = i};
    message.data = i % 3 == 0 ? MakeRawAudio(time_ns, 16000, 16, samples).SerializeAsString()
                              : MakeLaserScan(time_ns, -1.0, 1.0, range_m).SerializeAsString();
    const absl::Status status =
        (*writer)->Write(message.topic, message.schema, time_ns, message.sequence, message.data);
    if (!status.ok()) return Fail(status);
    shown.push_back(Show(message));
  }
  if (absl::Status status = (*writer)->Close(); !status.ok()) return Fail(status);
  std::cout << shown << "\n";
  return 0;
}

int ShowFile(const std::string& path) {
  auto reader = Reader::Open(path);
  if (!reader.ok()) return Fail(reader.status());
  nlohmann::json shown = nlohmann::json::array();
  while (true) {
    auto message = (*reader)->Next();
    if (!message.ok()) return Fail(message.status());
    if (!*message) break;
    shown.push_back(Show(**message));
  }
  std::cout << shown << "\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  if (arguments.size() == 2 && arguments[0] == "show") return ShowFile(arguments[1]);
  if (arguments.size() != 5 || arguments[0] != "write") return 2;
  WriterOptions options;
  options.chunk_bytes = 20'000;
  options.compression = arguments[2] == "zstd"  ? Compression::kZstd
                        : arguments[2] == "lz4" ? Compression::kLz4
                                                : Compression::kNone;
  options.chunked = arguments[3] == "chunked";
  options.summary = arguments[4] == "summary";
  return Write(arguments[1], options);
}
