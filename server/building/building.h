#pragma once

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "building/floor_plan.h"

namespace octomap {
class OcTree;
}

namespace soundmap::building {

// The geometric map of section II: an octree of the building, free, occupied and unknown kept
// apart, and its 2D slice. Immutable; shared between threads by pointer.
struct Building {
  // Null when the building is known by its floor plan alone.
  std::shared_ptr<const octomap::OcTree> octree;
  FloorPlan floor_plan;
};

// The slice between the two heights: a column with an occupied voxel is occupied, else with a free
// one free, else unknown. Cells are as large as the octree's voxels. InvalidArgument: nothing known
// at these heights.
absl::StatusOr<FloorPlan> SliceFloorPlan(const octomap::OcTree& octree, double min_height_m,
                                         double max_height_m);

}  // namespace soundmap::building
