#pragma once

#include <optional>
#include <vector>

#include "mapping/drive_limits.h"
#include "mapping/key_scan_graph.h"
#include "mapping/loop_closing.h"
#include "mapping/point_thinning.h"
#include "mapping/registration.h"
#include "mapping/scan_preparation.h"
#include "mapping/surface_map.h"

namespace soundmap::mapping {

struct DriveRegistrationConfig {
  double voxel_size_m = 0.05;
  double surface_voxel_size_m = 0.2;
  double key_scan_distance_m = 0.15;
  double key_scan_angle_rad = 0.1;
  int key_scans_per_place = 16;
  // False: scans are kept where the odometry has the robot; their poses come from elsewhere.
  bool align = true;
};

// A scan that was used.
struct PathEntry {
  frames::TimeNs stamp_ns = 0;
  geometry::Pose2 odom_from_base;
  // It moves with a key scan: the nearest it was aligned to.
  int scan = 0;
  Eigen::Isometry3d scan_from_base = Eigen::Isometry3d::Identity();
};

// Registers one drive's scans as they come: each is aligned to the surfaces seen from the key scans
// that are trusted at its place, and closes a loop where the robot comes back to others.
class DriveRegistration {
 public:
  // The robot is at `map_from_base` at the first odometry.
  DriveRegistration(const DriveRegistrationConfig& config, const geometry::Pose2& map_from_base);

  // `preparation` is what the scan came from.
  void Add(const PreparedScan& scan, const ScanPreparation& preparation);

  // The path's pose of an entry as the key scans are now.
  Eigen::Isometry3d PoseOf(const PathEntry& entry) const {
    return graph.scans[entry.scan].map_from_base * entry.scan_from_base;
  }

  KeyScanGraph graph;
  std::vector<PathEntry> path;
  LoopCount loops;
  int unregistered = 0;  // did not fit the map; by odometry alone

 private:
  struct Prediction {
    geometry::Pose2 map_from_base;
    bool odometry_is_sound = true;
  };

  Prediction Predict(const PreparedScan& scan, const ScanPreparation& preparation) const;
  Registration Align(const AlignedPoints& aligned, const Prediction& predicted,
                     frames::TimeNs stamp_ns) const;
  bool IsKeyScan(const PreparedScan& scan, const Eigen::Isometry3d& map_from_base) const;
  int NearestLocalScan(const Eigen::Isometry3d& map_from_base) const;
  void Keep(const PreparedScan& scan, const Eigen::Isometry3d& map_from_base, int anchor,
            const std::optional<Registration>& registration);
  void CloseLoops(int scan);
  void RenewLocalMap(int scan, bool moved);

  DriveRegistrationConfig config_;
  geometry::Pose2 start_map_from_base_;
  SurfaceMap local_map_;
  std::vector<bool> in_local_map_;  // for each key scan
  double seen_share_ = 0.0;         // of the recent scans' points, those that lay on steep surfaces
  double since_renewal_m_ = 0.0;
  double since_loop_m_ = 0.0;
  geometry::Pose2 last_key_odom_from_base_;
  KeyScanPlaces places_;
};

}  // namespace soundmap::mapping
