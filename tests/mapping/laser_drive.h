#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/frames.h"
#include "mapping/mapper.h"

namespace soundmap::mapping {

struct LaserDrive {
  frames::Calibration calibration;
  std::vector<frames::Frame> frames;  // LRF and odometry alone
};

// Of a recording.
absl::StatusOr<LaserDrive> ReadLaserDrive(const std::string& path);
// Of a CARMEN log.
absl::StatusOr<LaserDrive> ReadCarmenDrive(const std::string& path);

// Lines `timestamp_s,x,y,yaw` with comments.
std::vector<StampedPose> ReadPoses(const std::string& path);

// A relation of the SLAM benchmark: the pose at the second time as seen from the first.
struct PlanarRelation {
  frames::TimeNs begin_ns = 0;
  frames::TimeNs end_ns = 0;
  geometry::Pose2 begin_from_end;
};
std::vector<PlanarRelation> ReadRelations(const std::string& path);

struct RelationsError {
  double mean_m = 0.0;
  double std_m = 0.0;
  double mean_deg = 0.0;
  int relations = 0;
};
// Kuemmerle et al. 2009, eq. (1): the mean length and angle of true_relation^-1 * estimated
// relation. The path is interpolated; relations outside it are left out.
RelationsError ErrorOfRelations(const std::vector<StampedPose>& path,
                                const std::vector<PlanarRelation>& relations);

// Of a path at the times of the true poses, after the rigid motion that brings them closest.
struct PathError {
  double mean_m = 0.0;
  double max_m = 0.0;
  double mean_deg = 0.0;
  int poses = 0;
};
PathError ErrorOfPath(const std::vector<StampedPose>& path, const std::vector<StampedPose>& truth);

}  // namespace soundmap::mapping
