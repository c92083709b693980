#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/odometry_track.h"
#include "localization/config.h"
#include "localization/particle_filter.h"
#include "localization/pose_estimate.h"
#include "localization/prepared_plan.h"

namespace soundmap::localization {

struct InitialPose {
  geometry::Pose2 map_from_base;  // when the first odometry was taken
  double position_std_m = 0.1;    // of x and of y
  double yaw_std_rad = geometry::RadFromDeg(3.0);
};

struct Counters {
  std::int64_t corrections = 0;
  std::int64_t resamplings = 0;
  std::int64_t scans_ignored = 0;     // not newer than the one before, or older than the odometry
  std::int64_t scans_overflowed = 0;  // dropped from the full queue of those that wait for odometry
  std::int64_t scans_empty = 0;       // too few valid beams, or more than can be
  std::int64_t odometry_ignored = 0;  // not newer than the one before, or not finite
  std::int64_t odometry_jumps = 0;

  bool operator==(const Counters&) const = default;
};

struct Correction {
  PoseEstimate estimate;
  geometry::Pose2 odom_from_base;  // at the estimate's time
};

// All that a Localizer remembers; one made from it goes on bit by bit as the first would have.
struct LocalizerState {
  std::vector<Particle> particles;
  std::string engine;                            // std::mt19937_64, as operator<< writes it
  std::vector<frames::Odometry> odometry;        // its jumps taken out
  std::optional<frames::Odometry> raw_odometry;  // the newest, as it came
  std::vector<frames::LaserScan> waiting_scans;
  std::vector<Correction> corrections;  // oldest first
  std::optional<frames::TimeNs> newest_scan_ns;
  std::optional<frames::TimeNs> considered_until_ns;
  std::optional<geometry::Pose2> odom_from_particles;  // odom_from_base at the particles' time
  double mean_fit = 0.0;
  double travelled_m = 0.0;  // since the last correction
  bool jumped = false;       // the odometry did, since the last correction
  double misfit_m = 0.0;     // driven since the mean fit was last at tracking_fit
  bool misfit = false;       // lost by the rule of the scan fit
  Counters counters;
};

// Where one robot is on a floor plan: the particle filter of section II-A. Between corrections the
// odometry carries the pose on. Scans wait until odometry reaches over them. Deterministic: the
// result depends on the order of the calls and the seed alone. One thread at a time.
//
// State. The scan fit is the share of valid beams that end where the map says (beams into the
// unknown do not count), averaged over fit_memory corrections.
// Lost: after a mean fit below lost_fit, or lost_misfit_m driven with one below tracking_fit, until
// it reaches tracking_fit; a position spread above lost_position_std_m; more than lost_travel_m
// driven since the last correction. Uncertain, if not lost: the mean fit or the scan's own below
// tracking_fit, a spread above the tracking_* limits, more than tracking_travel_m driven since the
// last correction, or the odometry jumped since. Else tracking.
class Localizer {
 public:
  // FailedPrecondition without an initial pose; InvalidArgument: one that is not finite or lies off
  // the plan, a laser that is not mounted level.
  static absl::StatusOr<Localizer> Create(std::shared_ptr<const PreparedPlan> plan,
                                          const frames::Calibration& calibration,
                                          const std::optional<InitialPose>& initial_pose,
                                          std::uint64_t seed);
  // As Create(), and InvalidArgument when the state cannot be one of a Localizer with this
  // configuration.
  static absl::StatusOr<Localizer> Restore(std::shared_ptr<const PreparedPlan> plan,
                                           const frames::Calibration& calibration,
                                           const LocalizerState& state);

  // Each returns the corrections that became possible, oldest first; mostly none or one.
  std::vector<PoseEstimate> Add(const frames::Odometry& odometry);
  std::vector<PoseEstimate> Add(const frames::LaserScan& scan);

  // The pose at a time that the odometry covers: between two corrections both, carried there by
  // odometry and weighted by time; after the newest one that one, carried on. None before the first
  // correction, outside the odometry, and more than 30 s ago.
  std::optional<PoseEstimate> At(frames::TimeNs time_ns) const;

  // At() of a time up to the newest correction is final. A robot that stands gets no corrections:
  // once the scans up to a time were looked at, waiting longer for that time is of use only if it
  // drives on.
  std::optional<frames::TimeNs> newest_correction_ns() const;
  std::optional<frames::TimeNs> considered_until_ns() const { return memory_.considered_until_ns; }
  std::optional<frames::TimeNs> newest_odometry_ns() const;

  const Counters& counters() const { return memory_.counters; }
  const std::vector<Particle>& particles() const { return memory_.particles; }
  LocalizerState state() const;

 private:
  Localizer(std::shared_ptr<const PreparedPlan> plan, const frames::Calibration& calibration)
      : plan_(std::move(plan)), calibration_(calibration) {}

  std::vector<PoseEstimate> Drain();
  std::optional<PoseEstimate> Consider(const frames::LaserScan& scan);
  PoseEstimate Correct(frames::TimeNs time_ns, const geometry::Pose2& odom_from_base,
                       const std::vector<Beam>& beams);
  State Judge(const Eigen::Matrix3d& covariance, double fit, double travelled_m) const;

  std::shared_ptr<const PreparedPlan> plan_;
  frames::Calibration calibration_;
  std::mt19937_64 engine_;
  frames::OdometryTrack track_;
  std::deque<frames::LaserScan> waiting_scans_;
  std::deque<Correction> corrections_;
  LocalizerState memory_;  // its engine, odometry, waiting_scans and corrections are empty: they
                           // are the members above
};

}  // namespace soundmap::localization
