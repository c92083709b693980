#include "cli/truth_file.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "cli/text_file.h"

namespace soundmap::cli {
namespace {

using nlohmann::json;

constexpr std::int64_t kMaxTruthBytes = 16 << 20;

std::optional<double> AsNumber(const json& value) {
  if (!value.is_number()) return std::nullopt;
  const double number = value.get<double>();
  return std::isfinite(number) ? std::optional(number) : std::nullopt;
}

std::optional<Vector3> AsVector(const json& value) {
  if (!value.is_array() || value.size() != 3) return std::nullopt;
  const auto x = AsNumber(value[0]), y = AsNumber(value[1]), z = AsNumber(value[2]);
  if (!x || !y || !z) return std::nullopt;
  return Vector3{*x, *y, *z};
}

// An optional number: false if it is there and is none.
bool ReadNumber(const json& object, const char* key, std::optional<double>& number) {
  const auto field = object.find(key);
  if (field == object.end() || field->is_null()) return true;
  number = AsNumber(*field);
  return number.has_value();
}

std::optional<TrueSource> AsSource(const json& value) {
  if (!value.is_object() || !value.contains("position")) return std::nullopt;
  const auto position = AsVector(value["position"]);
  std::optional<double> extent_m, level;
  TrueSource source;
  if (!position || !ReadNumber(value, "extent_m", extent_m) || !ReadNumber(value, "level", level) ||
      !ReadNumber(value, "on_s", source.on_s) || !ReadNumber(value, "off_s", source.off_s)) {
    return std::nullopt;
  }
  source.position_in_map_m = *position;
  source.extent_m = extent_m.value_or(0.0);
  source.level = level.value_or(1.0);
  if (const auto kind = value.find("kind"); kind != value.end() && kind->is_string()) {
    source.kind = kind->get<std::string>();
  }
  return source;
}

std::optional<Box> AsBox(const json& value) {
  if (!value.is_array() || value.size() != 2) return std::nullopt;
  const auto a = AsVector(value[0]), b = AsVector(value[1]);
  if (!a || !b) return std::nullopt;
  return Box{.min_m = {std::min(a->x, b->x), std::min(a->y, b->y), std::min(a->z, b->z)},
             .max_m = {std::max(a->x, b->x), std::max(a->y, b->y), std::max(a->z, b->z)}};
}

}  // namespace

absl::StatusOr<SceneTruth> ReadTruthFile(const std::string& path) {
  const auto text = ReadTextFile(path, kMaxTruthBytes);
  if (!text.ok()) return text.status();
  const json document = json::parse(*text, /*cb=*/nullptr, /*allow_exceptions=*/false);
  const auto error = [&path](absl::string_view what) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", what));
  };
  if (!document.is_object()) return error("this is not a JSON object");
  if (document.contains("frame") && document["frame"] != "map") {
    return error("the frame is not \"map\"");
  }
  if (!document.contains("sources") || !document["sources"].is_array()) {
    return error("there is no list of sources");
  }
  SceneTruth truth;
  for (const json& value : document["sources"]) {
    auto source = AsSource(value);
    if (!source) {
      return error(absl::StrCat("source ", truth.sources.size(),
                                " has no usable position, extent_m, level, on_s or off_s"));
    }
    truth.sources.push_back(*std::move(source));
  }
  if (document.contains("room") && !document["room"].is_null()) {
    truth.room_size_m = AsVector(document["room"]);
    if (!truth.room_size_m) return error("the room is not three numbers");
  }
  if (document.contains("obstacles")) {
    if (!document["obstacles"].is_array()) return error("the obstacles are not a list");
    for (const json& value : document["obstacles"]) {
      const auto box = AsBox(value);
      if (!box) {
        return error(
            absl::StrCat("obstacle ", truth.obstacles.size(), " is not a box of two corners"));
      }
      truth.obstacles.push_back(*box);
    }
  }
  return truth;
}

}  // namespace soundmap::cli
