#include "api/decode_message.h"

#include <nlohmann/json.hpp>

#include "api/decode_frame.h"
#include "foxglove/KeyValuePair.pb.h"

namespace soundmap::api {
namespace {

constexpr char kGapSchema[] = "foxglove.KeyValuePair";
constexpr std::size_t kMaxGapBytes = 1024;
constexpr std::int64_t kMaxLostFrames = std::int64_t{1} << 40;

absl::StatusOr<pipeline::Gap> DecodeGap(const std::string& payload) {
  const absl::Status malformed = absl::InvalidArgumentError(
      "the record of lost frames is not a pair of `gap` and JSON with `frames`, `from_ns`, `to_ns` "
      "and `reason`");
  foxglove::KeyValuePair pair;
  if (payload.size() > kMaxGapBytes || !pair.ParseFromString(payload) || pair.key() != "gap") {
    return malformed;
  }
  const auto json = nlohmann::json::parse(pair.value(), nullptr, /*allow_exceptions=*/false);
  const auto number = [&json](const char* name) -> std::int64_t {
    const auto found = json.find(name);
    return found != json.end() && found->is_number_integer() ? found->get<std::int64_t>() : -1;
  };
  if (!json.is_object() || !json.contains("reason") || !json["reason"].is_string()) {
    return malformed;
  }
  const pipeline::Gap gap{0, number("frames"), number("from_ns"), number("to_ns"), json["reason"]};
  if (gap.frames < 1 || gap.frames > kMaxLostFrames || gap.from_ns < 0 || gap.to_ns < 0) {
    return malformed;
  }
  return gap;
}

}  // namespace

absl::StatusOr<pipeline::Session::Decoded> DecodeMessage(const recording::Message& message,
                                                         const frames::Calibration& calibration) {
  if (message.schema == kGapSchema) return DecodeGap(message.data);
  return DecodeFrame(message.schema, message.data, calibration);
}

}  // namespace soundmap::api
