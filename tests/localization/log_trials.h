#pragma once

#include <string>
#include <vector>

#include "localization/localizer.h"
#include "real_log.h"

namespace soundmap::localization {

// A log made ready to be driven on a plan; true poses are those of the laser.
struct Scene {
  std::string name;
  RealLog log;
  building::FloorPlan plan;
  double laser_x_m = 0.0;     // before base_link
  double lag_s = 0.0;         // at which the odometry's turns agree best with the true poses'
  bool is_lag_given = false;  // to the Localizer

  Config config() const;
  frames::Calibration calibration() const;
};

// From the shared data; the plan of the first two is drawn from the corrected poses.
Scene AcesScene();
Scene CsailScene();
// The slice of an octree of the building, at the heights that a point cloud is sliced at by
// default.
Scene Building079Scene();

struct TrackResult {
  int poses = 0;  // true poses compared
  double mean_m = 0.0, p95_m = 0.0, max_m = 0.0;
  double mean_yaw_rad = 0.0;
  double tracking_share = 0.0;
  double lost_share = 0.0;
  double mean_fit = 0.0;
  double correction_us = 0.0;
  double laser_lag_s = 0.0;  // in use at the end
  Counters counters;
  bool diverged() const { return !(max_m < 1.0); }
};

// Drives the whole log from the first true pose and asks for each true pose's time a second later.
TrackResult Track(const Scene& scene, const std::shared_ptr<const PreparedPlan>& plan,
                  std::uint64_t seed);

// The relations metric of the SLAM benchmark: mean error over the relations, in m and rad.
struct RelationsResult {
  int relations = 0;
  double mean_m = 0.0;
  double mean_rad = 0.0;
};
RelationsResult Relations(const std::string& relations_path, const std::vector<StampedPose>& path);
// Of a tracked drive, at each correction; laser poses at the log's stamps.
std::vector<StampedPose> TrackedPath(const Scene& scene,
                                     const std::shared_ptr<const PreparedPlan>& plan,
                                     std::uint64_t seed);

// A drive from an unknown start or with a robot carried off, see RunTrial.
struct TrialResult {
  double until_right_m =
      -1.0;  // driven (since carried off) until tracking at the right place; < 0: never
  double wrong_tracking_m = 0.0;       // driven while tracking at a wrong place
  double wrong_believed_m = 0.0;       // driven while not lost at a wrong place
  double noticed_m = -1.0;             // driven since carried off until not tracking
  int late_poses = 0;                  // looked at of the stretch driven while lost
  int late_right = 0, late_wrong = 0;  // of them, given as not lost
  double late_mean_m = 0.0;            // of the right ones
  double worst_call_us = 0.0;
  Counters counters;
};

// A robot that is carried from frame `from` of a log, up to which it was tracked for `before_m`, to
// frame `to`: stamps and odometry go on as if nothing had happened. From an unknown start at `to`
// when the two are equal. Ends after `drive_m`. `path`: where the robot was at each scan.
TrialResult RunTrial(const Scene& scene, const std::shared_ptr<const PreparedPlan>& plan,
                     const std::vector<StampedPose>& path, std::size_t from, std::size_t to,
                     double before_m, double drive_m, std::uint64_t seed);

// Frames to begin trials at, spread over a log; the robot drives on by `drive_m` from there.
std::vector<std::size_t> TrialStarts(const Scene& scene, const std::vector<StampedPose>& path,
                                     int count, double drive_m, std::uint64_t seed);

}  // namespace soundmap::localization
