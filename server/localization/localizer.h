#pragma once

#include <deque>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/laser_lag.h"
#include "localization/config.h"
#include "localization/health.h"
#include "localization/hypotheses.h"
#include "localization/kept_scan.h"
#include "localization/look_back.h"
#include "localization/particle_filter.h"
#include "localization/pose_estimate.h"
#include "localization/pose_history.h"
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
  std::int64_t searches = 0;        // scans that a lost robot looked for its place with
  std::int64_t losses = 0;          // times that a robot which knew its place lost it
  std::int64_t recoveries = 0;      // times that a lost robot found its place
  std::int64_t scans_given_up = 0;  // of a stretch too long to be kept while lost

  bool operator==(const Counters&) const = default;
};

// All that a Localizer remembers; one made from it goes on bit by bit as the first would have.
struct LocalizerState {
  std::vector<Particle> particles;  // none before a robot without a start has found its place
  std::string engine;               // std::mt19937_64, as operator<< writes it
  std::vector<frames::Odometry> odometry;        // its jumps taken out
  std::optional<frames::Odometry> raw_odometry;  // the newest, as it came
  std::vector<frames::LaserScan> waiting_scans;
  std::vector<Correction> corrections;  // oldest first
  std::optional<frames::TimeNs> newest_scan_ns;
  std::optional<frames::TimeNs> considered_until_ns;
  std::optional<geometry::Pose2> odom_from_particles;  // odom_from_base at the particles' time
  double mean_fit = 0.0;     // this one, slow_fit, misfit* and chance_m: Health
  double travelled_m = 0.0;  // since the last correction
  bool jumped = false;       // the odometry did, since the last correction
  double misfit_m = 0.0;
  bool misfit = false;
  double chance_m = 0.0;
  Counters counters;
  double laser_lag_s = 0.0;  // in use
  frames::LaserLag::State lag;

  double slow_fit = 0.0;
  std::uint64_t odometry_limit = 0;             // see PoseHistory
  std::optional<frames::TimeNs> keep_from_ns;   // as asked for
  std::optional<frames::TimeNs> lost_since_ns;  // see Localizer::lost_since_ns()
  bool searching = false;
  frames::TimeNs search_from_ns = 0;  // scans before it may be of another place
  int sectors_searched = 0;
  bool unrivalled = false;  // as far as searched, no other place explains the scans as well
  // Another place explains them clearly better than the robot's: as well as the map usually does,
  // or like no third one.
  bool rivalled = false;
  double since_sector_m = 0.0;  // driven since the last sector was searched
  std::vector<Hypothesis> hypotheses;
  std::vector<KeptScan> kept_scans;  // oldest first
  std::optional<LookBack> look_back;
};

// Where one robot is on a floor plan: the particle filter of section II-A. Between corrections the
// odometry carries the pose on. Scans wait until odometry reaches over them. Deterministic: the
// result depends on the order of the calls and the seed alone. One thread at a time.
//
// State. The scan fit is the share of valid beams that end where the map says (beams into the
// unknown do not count), averaged over fit_memory corrections.
// Lost: after a mean fit below lost_fit, or lost_misfit_m driven with one below tracking_fit; a
// position spread above lost_position_std_m; more than lost_travel_m driven since the last
// correction. Uncertain, if not lost: the mean fit or the scan's own below tracking_fit, a spread
// above the tracking_* limits, more than tracking_travel_m driven since the last correction, or the
// odometry jumped since. Else tracking.
//
// Search. A robot without a start, or whose scans stop to fit as they should, searches the whole
// plan (GlobalSearch) and carries on every place that fits (Hypotheses). A robot with a place keeps
// it until another explains the scans well and clearly better. While none explains them as well as
// the map usually does, it is uncertain, not lost, whatever the mean fit: the building has changed,
// not the robot's place; unless it has driven lost_chance_m with a mean fit below chance_fit. Once
// lost, it believes in its place again with a mean fit above lost_fit and no rival. One without a
// place is lost until one place has no rival. Then the kept scans tell where it was
// meanwhile (LookBack). With the search off, a robot is lost until the mean fit reaches
// tracking_fit.
class Localizer {
 public:
  // No initial pose: the robot searches. FailedPrecondition without one if the search is off;
  // InvalidArgument: one that is not finite or lies off the plan, a laser that is not mounted
  // level.
  static absl::StatusOr<Localizer> Create(std::shared_ptr<const PreparedPlan> plan,
                                          const frames::Calibration& calibration,
                                          const std::optional<InitialPose>& initial_pose,
                                          std::uint64_t seed);
  // As Create(), and InvalidArgument when the state cannot be one of a Localizer with this
  // configuration.
  static absl::StatusOr<Localizer> Restore(std::shared_ptr<const PreparedPlan> plan,
                                           const frames::Calibration& calibration,
                                           const LocalizerState& state);

  // Each returns the corrections that became possible, oldest first; mostly none or one. Those of a
  // robot that searches are its best guess, lost.
  std::vector<PoseEstimate> Add(const frames::Odometry& odometry);
  std::vector<PoseEstimate> Add(const frames::LaserScan& scan);

  // The pose at a time that the odometry covers: between two corrections both, carried there by
  // odometry and weighted by time; after the newest one that one, carried on. None before the first
  // correction, outside the odometry, and before what is kept.
  std::optional<PoseEstimate> At(frames::TimeNs time_ns) const;

  // At the newest odometry. None before the first correction and while lost.
  std::optional<OdometryFrame> odometry_frame() const;

  // The corrections in begin .. end, oldest first: after a recovery, where the robot was.
  std::vector<PoseEstimate> Path(frames::TimeNs begin_ns, frames::TimeNs end_ns) const;

  // At() of a time up to the newest correction is final, but from lost_since_ns() on: there the
  // robot is lost, the stretch included in which the scans had stopped to fit before that was
  // noticed, and At() will be another once it is found and has looked back. Before the first
  // odometry of a robot without a start: the smallest number. None: all is final.
  std::optional<frames::TimeNs> lost_since_ns() const { return memory_.lost_since_ns; }

  // If the last Add() learnt where the robot had been: since when At() and Path() are others.
  std::optional<frames::TimeNs> learnt_since_ns() const { return learnt_since_ns_; }

  // A robot that stands gets no corrections: once the scans up to a time were looked at, waiting
  // longer for that time is of use only if it drives on.
  std::optional<frames::TimeNs> newest_correction_ns() const;
  std::optional<frames::TimeNs> considered_until_ns() const { return memory_.considered_until_ns; }
  std::optional<frames::TimeNs> newest_odometry_ns() const;

  // The earliest time that At() may still be asked for; without it, 30 s before the newest
  // odometry. Kept within the bounds of SearchConfig::max_kept_scans.
  void KeepFrom(frames::TimeNs time_ns) { memory_.keep_from_ns = time_ns; }

  // By how much the stamps of the scans are later than those of the odometry: in use for the newest
  // scan. Estimates have the odometry's time.
  double laser_lag_s() const { return memory_.laser_lag_s; }

  const Counters& counters() const { return memory_.counters; }
  const std::vector<Particle>& particles() const { return memory_.particles; }
  LocalizerState state() const;

 private:
  Localizer(std::shared_ptr<const PreparedPlan> plan, const frames::Calibration& calibration);

  std::vector<PoseEstimate> Drain();
  std::optional<PoseEstimate> Consider(const frames::LaserScan& scan);
  PoseEstimate Correct(const KeptScan& scan, const std::vector<Beam>& beams,
                       const geometry::Pose2& moved);
  void LearnLag(const std::vector<Beam>& beams, const PoseEstimate& estimate, bool follows);
  void TakeUpLag();
  State Judge(const PoseEstimate& estimate, double travelled_m) const;
  void Forget();

  // In recovery.cc.
  void BeginSearch();
  std::optional<PoseEstimate> Search(const KeptScan& scan, const std::vector<Beam>& beams,
                                     const geometry::Pose2& moved,
                                     const std::optional<PoseEstimate>& own);
  PoseEstimate MoveTo(const Hypothesis& place, const KeptScan& scan,
                      const std::vector<Beam>& beams);
  void BeLost();
  void BeginLookBackFrom(const PoseEstimate& estimate);
  std::vector<const KeptScan*> RecentScans() const;
  void Keep(KeptScan scan);
  void ContinueLookBack(int max_scans);

  std::shared_ptr<const PreparedPlan> plan_;
  frames::Calibration calibration_;
  std::mt19937_64 engine_;
  std::deque<frames::LaserScan> waiting_scans_;
  PoseHistory history_;
  std::optional<frames::TimeNs> learnt_since_ns_;
  std::deque<KeptScan> kept_scans_;
  Health health_;
  frames::LaserLag lag_;
  LocalizerState memory_;  // what the members above hold is empty in it
};

}  // namespace soundmap::localization
