#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "building/building.h"
#include "mapping/mapper.h"
#include "pipeline/operations.h"
#include "pipeline/records.h"
#include "pipeline/session.h"
#include "storage/store.h"

namespace soundmap::pipeline {

struct DrivenMap {
  building::Building building;
  std::string report_json;
};

// Reads the logs of complete mapping drives through the mapping module, with surveyed poses instead
// of registration if there are any. The first drive fixes the frame, or `extend` does where it is
// given. Drives without a LIDAR become a floor plan, and extend that of a map that has no more or,
// its octree left as it is, of one that has. FailedPrecondition names a drive that does not overlap
// the others.
absl::StatusOr<DrivenMap> MapDrives(const std::vector<SessionRecord>& drives,
                                    const std::vector<mapping::StampedPose>& surveyed_poses,
                                    const std::shared_ptr<const building::Building>& extend,
                                    const Profile& profile, storage::Store* store,
                                    const Session::FrameDecoder& decode, OperationContext& context);

}  // namespace soundmap::pipeline
