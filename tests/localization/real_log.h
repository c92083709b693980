#pragma once

#include <string>
#include <vector>

#include "building/floor_plan.h"
#include "frames/frames.h"

namespace soundmap::localization {

// A log of a real robot in CARMEN's format with poses that others computed for it.
struct StampedPose {
  frames::TimeNs stamp_ns = 0;
  geometry::Pose2 map_from_base;
};

struct RealLog {
  std::vector<frames::Frame> frames;    // odometry and laser scans in the order of the log
  std::vector<StampedPose> true_poses;  // at stamps of scans
};

// Where the test data lie; empty when they are not there.
std::string DataFolder();

// A FLASER line is a scan; without ODOM lines its odometry, too. Readings of `no_return_m` and
// more are none. `poses`: time x y yaw, with commas.
RealLog ReadCarmenLog(const std::string& log_path, const std::string& poses_path,
                      double no_return_m);

// Occupied where more beams of the scans at the true poses ended than passed.
building::FloorPlan DrawPlan(const RealLog& log, double cell_size_m, double max_range_m);

// Moves a log's poses into another frame.
void Transform(const geometry::Pose2& map_from_log, std::vector<StampedPose>& poses);

// The first frame at or after a time.
std::size_t FirstAt(const RealLog& log, frames::TimeNs time_ns);

}  // namespace soundmap::localization
