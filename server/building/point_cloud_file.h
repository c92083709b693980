#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::building {

// The points of a `.ply` (ascii, binary_little_endian) or `.pcd` (ascii, binary) file: fields x, y,
// z of any number type, in any order, others ignored. Points that are not finite are left out
// ("invalid" in PCD). InvalidArgument: not such a file, a variant that is not read, a count that
// the file cannot hold, truncated, no finite point.
absl::StatusOr<std::vector<Eigen::Vector3d>> ParsePly(std::string_view bytes);
absl::StatusOr<std::vector<Eigen::Vector3d>> ParsePcd(std::string_view bytes);

// Binary little-endian, x, y, z as float32.
std::string PointsToPly(std::span<const Eigen::Vector3d> points);
std::string PointsToPcd(std::span<const Eigen::Vector3d> points);

}  // namespace soundmap::building
