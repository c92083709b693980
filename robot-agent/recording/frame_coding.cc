#include "recording/frame_coding.h"

#include <zstd.h>

#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "foxglove/PointCloud.pb.h"
#include "foxglove/RawAudio.pb.h"
#include "recording/flac_audio.h"
#include "recording/packed_points.h"

namespace soundmap::recording {
namespace {

constexpr std::string_view kAudioSchema = "foxglove.RawAudio";
constexpr std::string_view kPointsSchema = "foxglove.PointCloud";
constexpr std::string_view kAudioFormat = "pcm-s16";
constexpr int kZstdLevel = 1;
// Shorter messages have nothing to save.
constexpr std::size_t kMinPayloadBytes = 512;
constexpr std::uint32_t kMaxChannels = 256;

template <typename Message>
std::optional<Message> Parse(std::string_view payload) {
  Message message;
  if (!message.ParseFromArray(payload.data(), static_cast<int>(payload.size()))) {
    return std::nullopt;
  }
  return message;
}

// What stands before and behind `data` in the payload.
template <typename Coded>
bool SetEnds(std::string_view payload, std::string_view data, Coded& coded) {
  const std::size_t at = payload.find(data);
  if (at == std::string_view::npos) return false;
  coded.set_head(std::string(payload.substr(0, at)));
  coded.set_tail(std::string(payload.substr(at + data.size())));
  return true;
}

std::optional<std::string> CodeAudio(std::string_view payload) {
  const auto message = Parse<foxglove::RawAudio>(payload);
  if (!message || message->format() != kAudioFormat) return std::nullopt;
  const std::string& data = message->data();
  const std::uint32_t channels = message->number_of_channels();
  if (channels == 0 || channels > kMaxChannels || data.empty() ||
      data.size() % (sizeof(std::int16_t) * channels) != 0) {
    return std::nullopt;
  }
  std::vector<std::int16_t> samples(data.size() / sizeof(std::int16_t));
  std::memcpy(samples.data(), data.data(), data.size());
  auto streams = EncodeFlac(samples, static_cast<int>(channels));
  v1::FlacAudio coded;
  if (!streams.ok() || !SetEnds(payload, data, coded)) return std::nullopt;
  coded.set_channels(channels);
  coded.set_samples(static_cast<std::uint32_t>(samples.size() / channels));
  for (std::string& stream : *streams) coded.add_streams(std::move(stream));
  return coded.SerializeAsString();
}

std::optional<std::string> CodePoints(std::string_view payload, double resolution_m) {
  const auto message = Parse<foxglove::PointCloud>(payload);
  if (!message) return std::nullopt;
  auto packed = PackPoints(*message, resolution_m);
  if (!packed || !SetEnds(payload, message->data(), *packed)) return std::nullopt;
  return packed->SerializeAsString();
}

std::optional<std::string> CodeZstd(std::string_view payload) {
  std::string out(ZSTD_compressBound(payload.size()), '\0');
  const std::size_t size =
      ZSTD_compress(out.data(), out.size(), payload.data(), payload.size(), kZstdLevel);
  if (ZSTD_isError(size)) return std::nullopt;
  out.resize(size);
  return out;
}

absl::Status Misfit(std::int64_t payload_bytes) {
  return absl::InvalidArgumentError(
      absl::StrCat("what is coded is not the ", payload_bytes, " bytes that it should be"));
}

// The message around its data, which is still to be filled in.
template <typename Coded>
absl::StatusOr<std::string> Frame(const Coded& coded, std::uint64_t data_bytes,
                                  std::int64_t payload_bytes) {
  if (coded.head().size() + coded.tail().size() + data_bytes !=
      static_cast<std::uint64_t>(payload_bytes)) {
    return Misfit(payload_bytes);
  }
  std::string payload(static_cast<std::size_t>(payload_bytes), '\0');
  std::memcpy(payload.data(), coded.head().data(), coded.head().size());
  std::memcpy(payload.data() + coded.head().size() + data_bytes, coded.tail().data(),
              coded.tail().size());
  return payload;
}

absl::StatusOr<std::string> DecodeAudio(std::string_view bytes, std::int64_t payload_bytes) {
  const auto coded = Parse<v1::FlacAudio>(bytes);
  if (!coded) return absl::InvalidArgumentError("it is not a FlacAudio message");
  const std::uint64_t channels = coded->channels();
  if (channels == 0 || channels > kMaxChannels || coded->samples() == 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("its FLAC has ", channels, " channels of ", coded->samples(), " samples"));
  }
  const std::uint64_t data_bytes = sizeof(std::int16_t) * channels * coded->samples();
  auto payload = Frame(*coded, data_bytes, payload_bytes);
  if (!payload.ok()) return payload.status();
  const std::vector<const std::string*> streams(coded->streams().pointer_begin(),
                                                coded->streams().pointer_end());
  const absl::Status decoded =
      DecodeFlac(streams, static_cast<int>(channels),
                 std::span(payload->data() + coded->head().size(), data_bytes));
  if (!decoded.ok()) return decoded;
  return payload;
}

absl::StatusOr<std::string> DecodePoints(std::string_view bytes, std::int64_t payload_bytes) {
  const auto coded = Parse<v1::PackedPoints>(bytes);
  if (!coded) return absl::InvalidArgumentError("it is not a PackedPoints message");
  const std::uint64_t data_bytes = std::uint64_t{coded->point_count()} * coded->stride();
  auto payload = Frame(*coded, data_bytes, payload_bytes);
  if (!payload.ok()) return payload.status();
  const absl::Status unpacked =
      UnpackPoints(*coded, std::span(payload->data() + coded->head().size(), data_bytes));
  if (!unpacked.ok()) return unpacked;
  return payload;
}

absl::StatusOr<std::string> DecodeZstd(std::string_view bytes, std::int64_t payload_bytes) {
  std::string payload(static_cast<std::size_t>(payload_bytes), '\0');
  const std::size_t size =
      ZSTD_decompress(payload.data(), payload.size(), bytes.data(), bytes.size());
  if (ZSTD_isError(size) || size != payload.size()) return Misfit(payload_bytes);
  return payload;
}

}  // namespace

CodedFrame CodeFrame(std::string_view schema, std::string_view payload, const FrameCoding& coding) {
  if (payload.size() < kMinPayloadBytes) return {};
  const auto take = [&](v1::Coding how, std::optional<std::string> bytes) -> CodedFrame {
    if (!bytes || bytes->size() > payload.size() - payload.size() / 20) return {};
    return {how, *std::move(bytes)};
  };
  if (schema == kAudioSchema && coding.allowed.contains(v1::CODING_FLAC)) {
    return take(v1::CODING_FLAC, CodeAudio(payload));
  }
  if (schema == kPointsSchema && coding.allowed.contains(v1::CODING_POINTS)) {
    return take(v1::CODING_POINTS, CodePoints(payload, coding.lidar_resolution_m));
  }
  if (schema != kAudioSchema && coding.allowed.contains(v1::CODING_ZSTD)) {
    return take(v1::CODING_ZSTD, CodeZstd(payload));
  }
  return {};
}

absl::StatusOr<std::string> DecodeFrame(v1::Coding coding, std::string_view coded,
                                        std::int64_t payload_bytes) {
  switch (coding) {
    case v1::CODING_FLAC:
      return DecodeAudio(coded, payload_bytes);
    case v1::CODING_POINTS:
      return DecodePoints(coded, payload_bytes);
    case v1::CODING_ZSTD:
      return DecodeZstd(coded, payload_bytes);
    default:
      return absl::InvalidArgumentError(
          absl::StrCat("its coding ", static_cast<int>(coding), " is not known"));
  }
}

std::string SnapFrame(std::string_view schema, std::string payload, double resolution_m) {
  if (schema != kPointsSchema || !(resolution_m > 0.0)) return payload;
  auto message = Parse<foxglove::PointCloud>(payload);
  if (!message) return payload;
  const std::size_t at = std::string_view(payload).find(message->data());
  if (at == std::string::npos || !SnapPoints(resolution_m, *message)) return payload;
  std::memcpy(payload.data() + at, message->data().data(), message->data().size());
  return payload;
}

}  // namespace soundmap::recording
