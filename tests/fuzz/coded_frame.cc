#include <algorithm>
#include <cmath>

#include "recording/foxglove_messages.h"
#include "recording/frame_coding.h"
#include "tests/fuzz/target.h"

namespace soundmap::fuzz {
namespace {

constexpr v1::Coding kCodings[] = {v1::CODING_FLAC, v1::CODING_POINTS, v1::CODING_ZSTD};
constexpr std::size_t kHeaderBytes = 4;

// A byte for the coding, three for the size of the message.
std::string Seed(std::string_view schema, const std::string& message, v1::Coding coding) {
  const recording::CodedFrame coded = recording::CodeFrame(schema, message, {{coding}, 0.001});
  Require(coded.coding == coding);
  std::string seed(1, static_cast<char>(std::find(kCodings, kCodings + 3, coding) - kCodings));
  for (int shift = 0; shift < 24; shift += 8) {
    seed.push_back(static_cast<char>(message.size() >> shift));
  }
  return seed + coded.bytes;
}

}  // namespace

std::vector<std::string> Seeds() {
  std::vector<std::int16_t> samples(12 * 200);
  for (std::size_t i = 0; i < samples.size(); ++i) samples[i] = static_cast<std::int16_t>(i % 300);
  const std::string audio =
      recording::MakeRawAudio(1'000'000'000, 16000, 12, samples).SerializeAsString();
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 300; ++i) {
    points.push_back({std::cos(0.02f * i), std::sin(0.02f * i), 0.5f});
  }
  const std::string cloud = recording::SnapFrame(
      "foxglove.PointCloud", recording::MakePointCloud(5, points).SerializeAsString(), 0.001);
  foxglove::LaserScan scan;
  for (int i = 0; i < 200; ++i) scan.add_ranges(2.0);
  return {Seed("foxglove.RawAudio", audio, v1::CODING_FLAC),
          Seed("foxglove.PointCloud", cloud, v1::CODING_POINTS),
          Seed("foxglove.LaserScan", scan.SerializeAsString(), v1::CODING_ZSTD)};
}

void Decode(std::string_view bytes) {
  if (bytes.size() < kHeaderBytes) return;
  const auto byte = [bytes](std::size_t i) { return static_cast<unsigned char>(bytes[i]); };
  const std::int64_t size = byte(1) | byte(2) << 8 | byte(3) << 16;
  const auto message =
      recording::DecodeFrame(kCodings[byte(0) % 3], bytes.substr(kHeaderBytes), size);
  if (message.ok()) Require(static_cast<std::int64_t>(message->size()) == size);
}

}  // namespace soundmap::fuzz
