#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <span>
#include <vector>

#include "mapping/key_scan_graph.h"
#include "mapping/registration.h"

namespace soundmap::mapping {

// Where a drive's own map lies in another.
struct Placement {
  Eigen::Isometry3d map_from_drive = Eigen::Isometry3d::Identity();
  struct Scan {
    int scan = 0;  // of the drive
    Registration registration;
  };
  std::vector<Scan> verified;  // scans of the drive that were found in the map
};

// Places a drive by its surfaces: near where it is if `near_start`, else, or if it does not fit
// there, anywhere on the map. Several of its scans, spread over the drive, must be found where the
// others say that they are, and no other place may do nearly as well. None if that fails.
std::optional<Placement> PlaceDrive(const KeyScanGraph& drive, const SurfacePyramid& map,
                                    bool near_start);

}  // namespace soundmap::mapping
