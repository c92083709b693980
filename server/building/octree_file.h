#pragma once

#include <octomap/OcTree.h>

#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::building {

// OctoMap's two file formats, told apart by their first line: `.bt` (free, occupied or unknown in 2
// bits a node) and `.ot` (log-odds). The whole file is checked before OctoMap reads it, since
// OctoMap trusts its input. InvalidArgument: not such a file, another tree type than OcTree, a
// voxel size outside 0.005 to 1 m, no voxels, too many, a truncated or damaged tree.
absl::StatusOr<std::shared_ptr<octomap::OcTree>> ParseOctree(std::string_view bytes);

// Equal trees give equal bytes. `.bt` thresholds the log-odds.
std::string OctreeToBt(const octomap::OcTree& octree);
std::string OctreeToOt(const octomap::OcTree& octree);

}  // namespace soundmap::building
