#include "building/files.h"

#include <octomap/OcTree.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "building/octree_file.h"
#include "building/point_cloud_file.h"

namespace soundmap::building {
namespace {

constexpr std::uint64_t kMaxFileBytes = std::uint64_t{2} << 30;
constexpr std::uint64_t kMaxExportPoints = 200'000'000;
constexpr int kDepth = 16;

absl::StatusOr<std::string> ReadFile(const std::string& path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  if (error) {
    return absl::NotFoundError(absl::StrCat("cannot read ", path, ": ", error.message()));
  }
  if (size > kMaxFileBytes) {
    return absl::InvalidArgumentError(absl::StrCat(path, " is larger than 2 GiB"));
  }
  std::string bytes(size, '\0');
  std::ifstream file(path, std::ios::binary);
  if (!file.read(bytes.data(), static_cast<std::streamsize>(size))) {
    return absl::NotFoundError(absl::StrCat("cannot read ", path));
  }
  return bytes;
}

absl::StatusOr<Building> BuildingFromOctree(std::string_view bytes,
                                            const PointCloudConfig& config) {
  auto octree = ParseOctree(bytes);
  if (!octree.ok()) return octree.status();
  auto plan = SliceFloorPlan(**octree, config.slice_min_height_m, config.slice_max_height_m);
  if (!plan.ok()) return plan.status();
  return Building{*std::move(octree), *std::move(plan)};
}

absl::StatusOr<std::vector<Eigen::Vector3d>> OccupiedPoints(const octomap::OcTree& octree) {
  std::uint64_t count = 0;
  for (auto leaf = octree.begin_leafs(), end = octree.end_leafs(); leaf != end; ++leaf) {
    const int level = kDepth - static_cast<int>(leaf.getDepth());
    if (octree.isNodeOccupied(*leaf)) count += std::uint64_t{1} << (3 * level);
    if (count > kMaxExportPoints) {
      return absl::FailedPreconditionError(absl::StrCat("the building has more than ",
                                                        kMaxExportPoints,
                                                        " occupied voxels, too many for points"));
    }
  }
  std::vector<Eigen::Vector3d> points;
  points.reserve(count);
  const double voxel_size_m = octree.getResolution();
  for (auto leaf = octree.begin_leafs(), end = octree.end_leafs(); leaf != end; ++leaf) {
    if (!octree.isNodeOccupied(*leaf)) continue;
    const int voxels = 1 << (kDepth - static_cast<int>(leaf.getDepth()));
    const octomap::point3d first_centre = octree.keyToCoord(leaf.getIndexKey());
    const Eigen::Vector3d first(first_centre.x(), first_centre.y(), first_centre.z());
    for (int x = 0; x < voxels; ++x) {
      for (int y = 0; y < voxels; ++y) {
        for (int z = 0; z < voxels; ++z) {
          points.push_back(first + voxel_size_m * Eigen::Vector3d(x, y, z));
        }
      }
    }
  }
  return points;
}

absl::Status Named(const std::string& path, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat(path, ": ", status.message()));
}

}  // namespace

std::optional<MapFormat> MapFormatOfPath(std::string_view path) {
  const absl::string_view name(path.data(), path.size());
  if (absl::EndsWithIgnoreCase(name, ".bt")) return MapFormat::kBt;
  if (absl::EndsWithIgnoreCase(name, ".ot")) return MapFormat::kOt;
  if (absl::EndsWithIgnoreCase(name, ".ply")) return MapFormat::kPly;
  if (absl::EndsWithIgnoreCase(name, ".pcd")) return MapFormat::kPcd;
  if (absl::EndsWithIgnoreCase(name, ".yaml") || absl::EndsWithIgnoreCase(name, ".yml")) {
    return MapFormat::kRosYaml;
  }
  return std::nullopt;
}

absl::StatusOr<Building> ImportBuilding(const std::string& path, const PointCloudConfig& config) {
  const auto format = MapFormatOfPath(path);
  if (!format) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, " is not a map: its name must end in .bt, .ot, .ply, .pcd or .yaml"));
  }
  const auto bytes = ReadFile(path);
  if (!bytes.ok()) return bytes.status();
  std::string pgm;
  if (*format == MapFormat::kRosYaml) {
    const auto image_path = RosMapImagePath(*bytes);
    if (!image_path.ok()) return Named(path, image_path.status());
    auto image = ReadFile((std::filesystem::path(path).parent_path() / *image_path).string());
    if (!image.ok()) return Named(path, image.status());
    pgm = *std::move(image);
  }
  auto building = ImportBuilding(*format, *bytes, pgm, config);
  return building.ok() ? std::move(building) : Named(path, building.status());
}

absl::StatusOr<Building> ImportBuilding(MapFormat format, std::string_view bytes,
                                        std::string_view pgm, const PointCloudConfig& config) {
  switch (format) {
    case MapFormat::kBt:
    case MapFormat::kOt:
      return BuildingFromOctree(bytes, config);
    case MapFormat::kPly:
    case MapFormat::kPcd: {
      const auto points = format == MapFormat::kPly ? ParsePly(bytes) : ParsePcd(bytes);
      if (!points.ok()) return points.status();
      return BuildingFromPoints(*points, config);
    }
    case MapFormat::kRosYaml: {
      auto plan = ParseRosMap(bytes, pgm);
      if (!plan.ok()) return plan.status();
      return Building{nullptr, *std::move(plan)};
    }
  }
  return absl::InvalidArgumentError("the map's format is not known");
}

absl::StatusOr<std::string> ExportGeometry(const Building& building, MapFormat format) {
  if (!building.octree) {
    return absl::FailedPreconditionError(
        "the building is known by its floor plan alone, so it has no geometry to export");
  }
  switch (format) {
    case MapFormat::kBt:
      return OctreeToBt(*building.octree);
    case MapFormat::kOt:
      return OctreeToOt(*building.octree);
    case MapFormat::kPly:
    case MapFormat::kPcd: {
      const auto points = OccupiedPoints(*building.octree);
      if (!points.ok()) return points.status();
      return format == MapFormat::kPly ? PointsToPly(*points) : PointsToPcd(*points);
    }
    case MapFormat::kRosYaml:
      break;
  }
  return absl::InvalidArgumentError("geometry is exported as .bt, .ot, .ply or .pcd");
}

}  // namespace soundmap::building
