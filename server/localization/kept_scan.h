#pragma once

#include <vector>

#include "frames/frames.h"
#include "localization/scan_beams.h"

namespace soundmap::localization {

// What is kept of a scan that a correction was due for, to search with it or to look back with it.
struct KeptScan {
  frames::TimeNs stamp_ns = 0;
  geometry::Pose2 odom_from_base;
  std::vector<Beam> beams;
  bool jumped = false;  // the odometry did, since the kept scan before
};

}  // namespace soundmap::localization
