#pragma once

#include <Eigen/Core>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "frames/laser_lag.h"
#include "frames/odometry_track.h"
#include "mapping/drive_limits.h"
#include "mapping/floor_plan_mapper.h"
#include "mapping/laser_alignment.h"
#include "mapping/laser_lines.h"
#include "mapping/laser_loops.h"

namespace soundmap::mapping {

// One drive of an LRF, scan by scan: each is aligned to the walls of the last metres, and some are
// kept. Places are as the drive goes, no loop closed.
class LaserFrontEnd {
 public:
  LaserFrontEnd(const FloorPlanMapperConfig& config, const frames::Calibration& calibration,
                const geometry::Pose2& map_from_base);

  absl::Status Add(const frames::Odometry& odometry);
  absl::Status Add(const frames::LaserScan& scan);
  // Scans that still wait for odometry are used by what there is.
  void Finish() { ProcessWaiting(/*all=*/true); }

  std::vector<LaserPathEntry>& path() { return path_; }
  std::vector<LaserKeyScan>& key_scans() { return key_scans_; }
  const FloorPlanReport& report() const { return report_; }  // scans* alone
  double laser_lag_s() const { return frames::SecondsFromNs(lag_ns_); }
  // Why no scan was kept.
  absl::Status NothingToMap() const;

 private:
  struct WaitingScan {
    frames::LaserScan scan;
    frames::TimeNs end_ns = 0;
  };
  // The walls seen from the last metres of the way: one map to align to, and another begun later
  // that takes its place when the first covers the whole length.
  class LocalMap {
   public:
    LocalMap(double piece_m, double length_m)
        : piece_m_(piece_m), length_m_(length_m), current_(piece_m), next_(piece_m) {}

    void Insert(std::span<const Eigen::Vector2f> point_in_map, double way_m);
    const LineMap& lines() const { return current_; }

   private:
    double piece_m_;
    double length_m_;
    LineMap current_;
    LineMap next_;
    double current_from_m_ = 0.0;
    double next_from_m_ = 0.0;
  };

  void ProcessWaiting(bool all);
  void Process(const WaitingScan& waiting);
  geometry::Pose2 Predict(frames::TimeNs stamp_ns, const geometry::Pose2& odom_from_base,
                          bool& odometry_is_sound) const;
  void Keep(const LaserPathEntry& entry, LaserPoints points, std::vector<Eigen::Vector2f> to_match);
  bool HasMoved(const geometry::Pose2& map_from_base) const;

  const FloorPlanMapperConfig config_;
  const frames::Calibration calibration_;
  const geometry::Pose2 start_map_from_base_;
  const MotionLimits limits_;
  frames::TimeNs lag_ns_;
  frames::LaserLag lag_;

  frames::OdometryTrack track_;
  std::optional<geometry::Pose2> first_odom_from_base_;
  std::deque<WaitingScan> waiting_;
  LocalMap local_map_;
  std::optional<geometry::Pose2> inserted_at_;  // the last scan in the local map
  std::vector<LaserPathEntry> path_;
  std::vector<LaserKeyScan> key_scans_;
  // Since the last key scan.
  double way_m_ = 0.0;
  int unregistered_in_a_row_ = 0;
  Eigen::Matrix3d match_covariance_ = Eigen::Matrix3d::Zero();  // of the last scan
  Eigen::Matrix3d unregistered_covariance_ = Eigen::Matrix3d::Zero();
  KeyScanPlaces places_;
  FloorPlanReport report_;
  int scans_without_points_ = 0;
  int scans_without_odometry_ = 0;
};

}  // namespace soundmap::mapping
