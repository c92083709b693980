#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "building/building.h"
#include "building/point_cloud.h"
#include "building/ros_map.h"

namespace soundmap::building {

// `.bt`, `.ot` octree; `.ply`, `.pcd` points on surfaces; `.yaml` (with its `.pgm`) floor plan
// alone.
enum class MapFormat { kBt, kOt, kPly, kPcd, kRosYaml };

// By the file name's ending, in any case.
std::optional<MapFormat> MapFormatOfPath(std::string_view path);

// A building that exists already. Octrees keep their own voxel size; the slice for the floor plan
// is `config`'s, the rest of which serves point clouds. Errors: NotFound, or InvalidArgument with a
// sentence that names the file.
absl::StatusOr<Building> ImportBuilding(const std::string& path, const PointCloudConfig& config);

// The same from memory. A ROS map needs its picture, too; other formats ignore `pgm`.
absl::StatusOr<Building> ImportBuilding(MapFormat format, std::string_view bytes,
                                        std::string_view pgm, const PointCloudConfig& config);

// The octree as `.bt` or `.ot`, its occupied voxels' centres at the lowest level as `.ply` or
// `.pcd`. FailedPrecondition: the building has no octree.
absl::StatusOr<std::string> ExportGeometry(const Building& building, MapFormat format);

}  // namespace soundmap::building
