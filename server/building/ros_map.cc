#include "building/ros_map.h"

#include <yaml-cpp/yaml.h>

#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <optional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace soundmap::building {
namespace {

constexpr std::size_t kMaxYamlBytes = 64 << 10;

constexpr std::uint8_t kOccupiedGrey = 0;
constexpr std::uint8_t kFreeGrey = 254;
constexpr std::uint8_t kUnknownGrey = 205;
constexpr double kOccupiedThreshold = 0.65;
constexpr double kFreeThreshold = 0.196;  // below kUnknownGrey's 0.19608

absl::StatusOr<YAML::Node> LoadYaml(std::string_view yaml) {
  if (yaml.size() > kMaxYamlBytes) {
    return absl::InvalidArgumentError("the map's YAML is longer than 64 KiB");
  }
  try {
    YAML::Node root = YAML::Load(std::string(yaml));
    if (root.IsMap()) return root;
  } catch (const YAML::Exception&) {
  }
  return absl::InvalidArgumentError("the map's YAML is not a list of names and values");
}

template <typename Value>
absl::StatusOr<Value> Field(const YAML::Node& parent, const char* name) {
  try {
    return parent[name].as<Value>();
  } catch (const YAML::Exception&) {
    return absl::InvalidArgumentError(absl::StrCat("the map's YAML lacks a proper '", name, "'"));
  }
}

struct MapMetadata {
  double resolution_m = 0.0;
  std::vector<double> origin;  // x, y in metres, yaw
  bool negate = false;
  double occupied_threshold = 0.0;
  double free_threshold = 0.0;
};

absl::StatusOr<MapMetadata> ParseMetadata(std::string_view yaml) {
  const auto root = LoadYaml(yaml);
  if (!root.ok()) return root.status();
  const auto resolution_m = Field<double>(*root, "resolution");
  const auto origin = Field<std::vector<double>>(*root, "origin");
  const auto negate = Field<int>(*root, "negate");
  const auto occupied = Field<double>(*root, "occupied_thresh");
  const auto free = Field<double>(*root, "free_thresh");
  for (const absl::Status& status : {resolution_m.status(), origin.status(), negate.status(),
                                     occupied.status(), free.status()}) {
    if (!status.ok()) return status;
  }
  if (!(*resolution_m >= 0.005 && *resolution_m <= 1.0)) {
    return absl::InvalidArgumentError("the map's resolution in its YAML is outside 0.005 to 1 m");
  }
  if (origin->size() != 3 || !std::isfinite((*origin)[0]) || !std::isfinite((*origin)[1])) {
    return absl::InvalidArgumentError("the map's origin in its YAML is not [x, y, yaw]");
  }
  if ((*origin)[2] != 0.0) {
    return absl::InvalidArgumentError(
        "the map is turned (its origin's yaw is not 0); only maps along x and y are read");
  }
  if (!(*free >= 0.0 && *free <= *occupied && *occupied <= 1.0)) {
    return absl::InvalidArgumentError(
        "the map's free_thresh and occupied_thresh in its YAML are not in order from 0 to 1");
  }
  if ((*root)["mode"]) {
    const auto mode = Field<std::string>(*root, "mode");
    if (!mode.ok()) return mode.status();
    if (*mode != "trinary" && *mode != "scale") {
      return absl::InvalidArgumentError(
          "the map's mode in its YAML is not read; trinary and scale are");
    }
  }
  return MapMetadata{*resolution_m, *origin, *negate != 0, *occupied, *free};
}

struct Picture {
  int width = 0;
  int height = 0;
  int max_grey = 0;
  std::string_view greys;  // row-major, the top row first
};

// Numbers of a PGM header; white space separates, `#` begins a comment.
std::optional<int> NextNumber(std::string_view pgm, std::size_t& position) {
  while (position < pgm.size()) {
    if (pgm[position] == '#') {
      position = std::min(pgm.find('\n', position), pgm.size());
    } else if (std::isspace(static_cast<unsigned char>(pgm[position]))) {
      ++position;
    } else {
      break;
    }
  }
  int number = 0;
  const auto [end, error] = std::from_chars(pgm.data() + position, pgm.data() + pgm.size(), number);
  if (error != std::errc()) return std::nullopt;
  position = end - pgm.data();
  return number;
}

absl::StatusOr<Picture> ParsePgm(std::string_view pgm) {
  if (pgm.substr(0, 2) != "P5") {
    return absl::InvalidArgumentError("the map's picture is not a binary PGM file (P5)");
  }
  std::size_t position = 2;
  const auto width = NextNumber(pgm, position);
  const auto height = NextNumber(pgm, position);
  const auto max_grey = NextNumber(pgm, position);
  if (!width || !height || !max_grey || *width <= 0 || *height <= 0 || *max_grey <= 0 ||
      *max_grey > 255) {
    return absl::InvalidArgumentError("the map's picture has a damaged PGM header");
  }
  const std::int64_t cells = std::int64_t{*width} * *height;
  if (cells > kMaxFloorPlanCells) {
    return absl::InvalidArgumentError(
        absl::StrFormat("the map's picture has %d x %d cells, more than the limit of %d", *width,
                        *height, kMaxFloorPlanCells));
  }
  ++position;  // the one separator after the header
  if (position > pgm.size() || static_cast<std::int64_t>(pgm.size() - position) < cells) {
    return absl::InvalidArgumentError("the map's picture is truncated");
  }
  return Picture{*width, *height, *max_grey, pgm.substr(position, cells)};
}

}  // namespace

absl::StatusOr<std::string> RosMapImagePath(std::string_view yaml) {
  const auto root = LoadYaml(yaml);
  if (!root.ok()) return root.status();
  return Field<std::string>(*root, "image");
}

absl::StatusOr<FloorPlan> ParseRosMap(std::string_view yaml, std::string_view pgm) {
  const auto metadata = ParseMetadata(yaml);
  if (!metadata.ok()) return metadata.status();
  const auto picture = ParsePgm(pgm);
  if (!picture.ok()) return picture.status();

  FloorPlan plan(picture->width, picture->height, metadata->resolution_m,
                 Eigen::Vector2d(metadata->origin[0], metadata->origin[1]));
  for (int row = 0; row < plan.height(); ++row) {
    const std::size_t picture_row = plan.height() - 1 - row;
    for (int column = 0; column < plan.width(); ++column) {
      const auto grey =
          static_cast<std::uint8_t>(picture->greys[picture_row * plan.width() + column]);
      const double brightness = static_cast<double>(grey) / picture->max_grey;
      const double occupancy = metadata->negate ? brightness : 1.0 - brightness;
      if (occupancy > metadata->occupied_threshold) {
        plan.at(column, row) = Cell::kOccupied;
      } else if (occupancy < metadata->free_threshold) {
        plan.at(column, row) = Cell::kFree;
      }
    }
  }
  return plan;
}

RosMap ToRosMap(const FloorPlan& floor_plan, std::string_view image_path) {
  RosMap map;
  YAML::Emitter yaml;
  yaml.SetDoublePrecision(17);
  yaml << YAML::BeginMap << YAML::Key << "image" << YAML::Value << std::string(image_path)
       << YAML::Key << "mode" << YAML::Value << "trinary" << YAML::Key << "resolution"
       << YAML::Value << floor_plan.cell_size_m() << YAML::Key << "origin" << YAML::Value
       << YAML::Flow << YAML::BeginSeq << floor_plan.origin_in_map_m().x()
       << floor_plan.origin_in_map_m().y() << 0.0 << YAML::EndSeq << YAML::Key << "negate"
       << YAML::Value << 0 << YAML::Key << "occupied_thresh" << YAML::Value << kOccupiedThreshold
       << YAML::Key << "free_thresh" << YAML::Value << kFreeThreshold << YAML::EndMap;
  map.yaml = absl::StrCat(yaml.c_str(), "\n");
  map.pgm = absl::StrCat("P5\n", floor_plan.width(), " ", floor_plan.height(), "\n255\n");
  map.pgm.reserve(map.pgm.size() + floor_plan.cells().size());
  for (int row = floor_plan.height() - 1; row >= 0; --row) {
    for (int column = 0; column < floor_plan.width(); ++column) {
      const Cell cell = floor_plan.at(column, row);
      const std::uint8_t grey = cell == Cell::kOccupied ? kOccupiedGrey
                                : cell == Cell::kFree   ? kFreeGrey
                                                        : kUnknownGrey;
      map.pgm.push_back(static_cast<char>(grey));
    }
  }
  return map;
}

}  // namespace soundmap::building
