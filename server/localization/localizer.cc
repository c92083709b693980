#include "localization/localizer.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <utility>

#include "absl/strings/str_cat.h"

namespace soundmap::localization {
namespace {

constexpr double kHistory_s = 30.0;

// Stamps jitter: a motion up to this is no jump, however short the time.
constexpr double kJumpTolerance_m = 0.2;
constexpr double kJumpTolerance_rad = 0.2;

constexpr double kMaxLag_s = 1.0;
// Smaller changes of the laser's lag are not worth a break in the odometry's time.
constexpr double kLagStep_s = 0.01;
// A lag known this badly is better than none, which may be a tenth of a second.
constexpr double kMaxLagStd_s = 0.025;
// Variances with which a scan is laid on the walls near the filter's estimate: 0.1 m, 10 degrees.
const Eigen::Vector3d kNear(0.01, 0.01, 0.03);

constexpr double kMaxLaserTilt_rad = geometry::RadFromDeg(5.0);
constexpr std::size_t kMaxBeamsOfScan = 20'000;

// Of the valid beams, for refinement and the scan fit.
constexpr int kMaxBeamsOfFit = 1000;

bool IsFinite(const geometry::Pose2& pose) {
  return std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.yaw_rad);
}

bool AreParticles(const std::vector<Particle>& particles) {
  return !particles.empty() &&
         std::all_of(particles.begin(), particles.end(), [](const Particle& particle) {
           return IsFinite(particle.map_from_base) && particle.log_weight <= 1e-6;
         });
}

absl::Status CheckLaser(const frames::Calibration& calibration) {
  if (absl::Status status = calibration.Validate(); !status.ok()) return status;
  const double up = std::abs(calibration.base_from_laser.linear()(2, 2));
  if (!(up >= std::cos(kMaxLaserTilt_rad))) {
    return absl::InvalidArgumentError(
        "the calibration's base_from_laser is tilted by more than 5 degrees: localization needs a "
        "laser that scans parallel to the floor");
  }
  return absl::OkStatus();
}

}  // namespace

Localizer::Localizer(std::shared_ptr<const PreparedPlan> plan,
                     const frames::Calibration& calibration)
    : plan_(std::move(plan)), calibration_(calibration), history_(plan_->config.motion) {}

absl::StatusOr<Localizer> Localizer::Create(std::shared_ptr<const PreparedPlan> plan,
                                            const frames::Calibration& calibration,
                                            const std::optional<InitialPose>& initial_pose,
                                            std::uint64_t seed) {
  if (absl::Status status = CheckLaser(calibration); !status.ok()) return status;
  Localizer localizer(std::move(plan), calibration);
  localizer.engine_.seed(seed);
  LocalizerState& memory = localizer.memory_;
  memory.laser_lag_s = localizer.plan_->config.laser_lag_s.value_or(0.0);
  if (!initial_pose) {
    if (!localizer.plan_->config.search.enabled) {
      return absl::FailedPreconditionError(
          "the robot has no initial pose, and the search for an unknown place is switched off");
    }
    memory.searching = true;
    memory.lost_since_ns = std::numeric_limits<frames::TimeNs>::min();
    memory.search_from_ns = *memory.lost_since_ns;
    return localizer;
  }
  const geometry::Pose2& start = initial_pose->map_from_base;
  if (!IsFinite(start) ||
      !(initial_pose->position_std_m >= 0.0 && initial_pose->position_std_m <= 1000.0) ||
      !(initial_pose->yaw_std_rad >= 0.0 && initial_pose->yaw_std_rad <= geometry::kPi)) {
    return absl::InvalidArgumentError(
        "the initial pose or its spread is not finite, or the spread is out of range");
  }
  if (!localizer.plan_->bounds_in_map_m.contains(Eigen::Vector2d(start.x_m, start.y_m))) {
    return absl::InvalidArgumentError(absl::StrCat("the initial pose (", start.x_m, ", ", start.y_m,
                                                   ") lies outside the floor plan"));
  }
  memory.particles = Scatter(start, initial_pose->position_std_m, initial_pose->yaw_std_rad,
                             localizer.plan_->config.particles, localizer.engine_);
  return localizer;
}

absl::StatusOr<Localizer> Localizer::Restore(std::shared_ptr<const PreparedPlan> plan,
                                             const frames::Calibration& calibration,
                                             const LocalizerState& state) {
  if (absl::Status status = CheckLaser(calibration); !status.ok()) return status;
  const absl::Status refused =
      absl::InvalidArgumentError("the saved state of the localization does not fit this site");
  const Config& config = plan->config;
  Localizer localizer(std::move(plan), calibration);

  std::istringstream engine(state.engine);
  if (!(engine >> localizer.engine_)) return refused;
  if (state.searching) {
    if (!config.search.enabled) return refused;
    for (const Hypothesis& hypothesis : state.hypotheses) {
      if (!AreParticles(hypothesis.particles) || !std::isfinite(hypothesis.evidence)) {
        return refused;
      }
    }
  }
  if (state.particles.empty()) {
    if (!state.searching || !state.lost_since_ns) return refused;
  } else if (!AreParticles(state.particles) ||
             (!config.adaptive.enabled &&
              static_cast<int>(state.particles.size()) != config.particles)) {
    return refused;
  }
  if (state.look_back && !AreParticles(state.look_back->particles)) return refused;
  for (const frames::Odometry& odometry : state.odometry) {
    if (!localizer.history_.Add(odometry)) return refused;
  }
  if (state.raw_odometry.has_value() != !state.odometry.empty() ||
      state.odom_from_particles.has_value() != state.raw_odometry.has_value() ||
      static_cast<int>(state.waiting_scans.size()) > config.max_waiting_scans) {
    return refused;
  }
  if (!localizer.lag_.Restore(state.lag) || !(std::abs(state.laser_lag_s) <= kMaxLag_s) ||
      (config.laser_lag_s && *config.laser_lag_s != state.laser_lag_s)) {
    return refused;
  }
  for (const Correction& correction : state.corrections) localizer.history_.Add(correction);
  localizer.history_.set_odometry_limit(state.odometry_limit);
  localizer.waiting_scans_.assign(state.waiting_scans.begin(), state.waiting_scans.end());
  localizer.kept_scans_.assign(state.kept_scans.begin(), state.kept_scans.end());
  localizer.health_ = {state.mean_fit, state.slow_fit, state.misfit_m, state.misfit,
                       state.chance_m};

  localizer.memory_ = state;
  localizer.memory_.engine.clear();
  localizer.memory_.odometry.clear();
  localizer.memory_.waiting_scans.clear();
  localizer.memory_.corrections.clear();
  localizer.memory_.kept_scans.clear();
  localizer.memory_.lag = {};
  return localizer;
}

LocalizerState Localizer::state() const {
  LocalizerState state = memory_;
  std::ostringstream engine;
  engine << engine_;
  state.engine = engine.str();
  const frames::OdometryTrack& track = history_.track();
  state.odometry.assign(track.entries().begin(), track.entries().end());
  state.odometry_limit = history_.odometry_limit();
  state.waiting_scans.assign(waiting_scans_.begin(), waiting_scans_.end());
  state.corrections.assign(history_.corrections().begin(), history_.corrections().end());
  state.kept_scans.assign(kept_scans_.begin(), kept_scans_.end());
  state.lag = lag_.state();
  state.mean_fit = health_.mean_fit;
  state.slow_fit = health_.slow_fit;
  state.misfit_m = health_.misfit_m;
  state.misfit = health_.misfit;
  state.chance_m = health_.chance_m;
  return state;
}

std::vector<PoseEstimate> Localizer::Add(const frames::Odometry& odometry) {
  learnt_since_ns_.reset();
  if (!IsFinite(odometry.odom_from_base) ||
      (memory_.raw_odometry && odometry.stamp_ns <= memory_.raw_odometry->stamp_ns)) {
    ++memory_.counters.odometry_ignored;
    return {};
  }
  // Jumps are taken out: the track stands still over one.
  geometry::Pose2 odom_from_base = odometry.odom_from_base;
  if (memory_.raw_odometry) {
    const geometry::Pose2 before_from_now =
        memory_.raw_odometry->odom_from_base.Inverse() * odometry.odom_from_base;
    const double elapsed_s =
        frames::SecondsFromNs(odometry.stamp_ns - memory_.raw_odometry->stamp_ns);
    const double driven_m = std::hypot(before_from_now.x_m, before_from_now.y_m);
    odom_from_base = history_.track().entries().back().odom_from_base;
    if (driven_m > kJumpTolerance_m + plan_->config.max_speed_mps * elapsed_s ||
        std::abs(before_from_now.yaw_rad) >
            kJumpTolerance_rad + plan_->config.max_turn_rate_radps * elapsed_s) {
      ++memory_.counters.odometry_jumps;
      memory_.jumped = true;
    } else {
      odom_from_base = odom_from_base * before_from_now;
      memory_.travelled_m += driven_m;
    }
  } else {
    memory_.odom_from_particles = odom_from_base;
    if (memory_.searching) memory_.lost_since_ns = odometry.stamp_ns;
  }
  memory_.raw_odometry = odometry;
  history_.Add(frames::Odometry{odometry.stamp_ns, odom_from_base});
  Forget();
  return Drain();
}

void Localizer::Forget() {
  frames::TimeNs keep_ns = memory_.raw_odometry->stamp_ns - frames::NsFromSeconds(kHistory_s);
  if (memory_.keep_from_ns) keep_ns = std::min(keep_ns, *memory_.keep_from_ns);
  if (memory_.lost_since_ns) keep_ns = std::min(keep_ns, *memory_.lost_since_ns);
  // The stretch looked back over, and as much after it while it is read.
  history_.Forget(keep_ns, 2 * static_cast<std::size_t>(plan_->config.search.max_kept_scans));
}

std::vector<PoseEstimate> Localizer::Add(const frames::LaserScan& scan) {
  learnt_since_ns_.reset();
  if (scan.range_m.empty() || scan.range_m.size() > kMaxBeamsOfScan ||
      !std::isfinite(scan.start_angle_rad) || !std::isfinite(scan.angle_increment_rad)) {
    ++memory_.counters.scans_empty;
    return {};
  }
  if (memory_.newest_scan_ns && scan.stamp_ns <= *memory_.newest_scan_ns) {
    ++memory_.counters.scans_ignored;
    return {};
  }
  memory_.newest_scan_ns = scan.stamp_ns;
  waiting_scans_.push_back(scan);
  std::vector<PoseEstimate> corrections = Drain();
  if (static_cast<int>(waiting_scans_.size()) > plan_->config.max_waiting_scans) {
    waiting_scans_.pop_front();
    ++memory_.counters.scans_overflowed;
  }
  return corrections;
}

// Looks at the waiting scans over which the odometry reaches by now.
std::vector<PoseEstimate> Localizer::Drain() {
  std::vector<PoseEstimate> corrections;
  const frames::OdometryTrack& track = history_.track();
  if (track.empty()) return corrections;
  while (!waiting_scans_.empty()) {
    TakeUpLag();
    const frames::LaserScan& scan = waiting_scans_.front();
    const frames::TimeNs first_beam_ns = scan.stamp_ns - frames::NsFromSeconds(memory_.laser_lag_s);
    const frames::TimeNs last_beam_ns =
        first_beam_ns + frames::NsFromSeconds(static_cast<double>(scan.range_m.size()) *
                                              calibration_.laser_time_increment_s);
    if (first_beam_ns < track.oldest_ns()) {
      ++memory_.counters.scans_ignored;
    } else if (last_beam_ns > track.newest_ns()) {
      break;
    } else if (const auto correction = Consider(scan)) {
      corrections.push_back(*correction);
    }
    waiting_scans_.pop_front();
  }
  return corrections;
}

// Corrects when the robot moved enough since the last correction.
std::optional<PoseEstimate> Localizer::Consider(const frames::LaserScan& scan) {
  const Config& config = plan_->config;
  const frames::TimeNs time_ns =
      MiddleOf(scan, calibration_.laser_time_increment_s, memory_.laser_lag_s);
  if (!kept_scans_.empty() && time_ns <= kept_scans_.back().stamp_ns) {
    ++memory_.counters.scans_ignored;  // the lag has grown since
    return std::nullopt;
  }
  const geometry::Pose2 odom_from_base = *history_.track().At(time_ns);
  const geometry::Pose2 moved = memory_.odom_from_particles->Inverse() * odom_from_base;
  const bool due = kept_scans_.empty() || memory_.jumped ||
                   std::hypot(moved.x_m, moved.y_m) >= config.correction_distance_m ||
                   std::abs(moved.yaw_rad) >= config.correction_turn_rad;
  const frames::TimeNs considered_ns =
      std::max(memory_.considered_until_ns.value_or(time_ns), time_ns);
  if (!due) {
    memory_.considered_until_ns = considered_ns;
    return std::nullopt;
  }
  const auto beams =
      ValidBeams(scan, calibration_, memory_.laser_lag_s, config.min_range_m, history_.track());
  if (!beams || static_cast<int>(beams->size()) < config.min_beams) {
    ++memory_.counters.scans_empty;
    return std::nullopt;
  }
  memory_.considered_until_ns = considered_ns;
  const bool jumped = memory_.jumped;
  const std::int64_t recoveries = memory_.counters.recoveries;
  Keep({time_ns, odom_from_base, Subsample(*beams, config.beams), memory_.jumped});
  const std::vector<Beam> fit_beams = Subsample(*beams, kMaxBeamsOfFit);
  const KeptScan& kept = kept_scans_.back();
  std::optional<PoseEstimate> estimate;
  if (!memory_.particles.empty()) estimate = Correct(kept, fit_beams, moved);
  if (config.search.enabled) {
    if (!memory_.searching && estimate && health_.IsDoubtful(estimate->scan_fit, config.health))
      BeginSearch();
    if (memory_.searching) estimate = Search(kept, fit_beams, moved, estimate);
  }
  if (estimate) history_.Add(Correction{*estimate, odom_from_base});
  memory_.odom_from_particles = odom_from_base;
  memory_.jumped = false;
  memory_.travelled_m = 0.0;
  if (estimate && !memory_.particles.empty() && !config.laser_lag_s) {
    LearnLag(fit_beams, *estimate,
             !jumped && recoveries == memory_.counters.recoveries &&
                 estimate->scan_fit >= config.health.lost_fit);
  }
  if (estimate && memory_.look_back) ContinueLookBack(config.search.look_back_scans);
  return estimate;
}

// `beams`: more of them than the scan keeps.
PoseEstimate Localizer::Correct(const KeptScan& scan, const std::vector<Beam>& beams,
                                const geometry::Pose2& moved) {
  const Config& config = plan_->config;
  std::vector<Particle>& particles = memory_.particles;
  Predict(MotionModel(config.motion, moved), particles, engine_);
  if (scan.jumped) Spread(config, particles, engine_);
  localization::Correct(scan.beams, plan_->caster, plan_->model, config.tempering, particles);

  PoseEstimate estimate = Estimate(*plan_, scan.stamp_ns, beams, particles);
  if (history_.corrections().empty())
    health_.Begin(estimate.scan_fit);
  else
    health_.Take(estimate.scan_fit, memory_.travelled_m, !memory_.searching || memory_.unrivalled,
                 config.health);
  memory_.jumped = false;
  estimate.state = Judge(estimate, 0.0);

  if (estimate.effective_particles <
      config.resample_below * static_cast<double>(particles.size())) {
    const int count =
        config.adaptive.enabled ? AdaptiveCount(particles, config.adaptive) : config.particles;
    particles = Resample(particles, count, engine_);
    ++memory_.counters.resamplings;
  }
  ++memory_.counters.corrections;
  return estimate;
}

// `follows`: the robot has kept its place since the correction before.
void Localizer::LearnLag(const std::vector<Beam>& beams, const PoseEstimate& estimate,
                         bool follows) {
  // By the walls alone: the filter's heading follows the odometry at the lag in use.
  const auto matched = plan_->matcher.Match(beams, {estimate.map_from_base, kNear.asDiagonal()});
  if (!follows || !matched) lag_.Break();
  if (matched) {
    lag_.Add(estimate.stamp_ns + frames::NsFromSeconds(memory_.laser_lag_s), matched->mean.yaw_rad);
  }
  lag_.Follow(history_.track());
}

void Localizer::TakeUpLag() {
  if (plan_->config.laser_lag_s || kept_scans_.empty()) return;
  const std::optional<double> lag_s = lag_.lag_s(kMaxLagStd_s);
  if (!lag_s || std::abs(*lag_s - memory_.laser_lag_s) < kLagStep_s) return;
  // The particles are where the robot was at another time of the odometry than was thought.
  const auto odom_from_base =
      history_.track().At(kept_scans_.back().stamp_ns + frames::NsFromSeconds(memory_.laser_lag_s) -
                          frames::NsFromSeconds(*lag_s));
  if (!odom_from_base) return;
  memory_.odom_from_particles = *odom_from_base;
  memory_.laser_lag_s = *lag_s;
}

State Localizer::Judge(const PoseEstimate& estimate, double travelled_m) const {
  const HealthConfig& health = plan_->config.health;
  const double position_std_m = std::sqrt(estimate.covariance(0, 0) + estimate.covariance(1, 1));
  State state = health_.Judge(estimate.scan_fit, health);
  if (memory_.searching) {
    state = std::max(state, State::kUncertain);
    const bool is_lost = memory_.lost_since_ns && !memory_.look_back;
    const bool believes = is_lost ? memory_.unrivalled && health_.mean_fit >= health.lost_fit
                                  : !memory_.rivalled && health_.chance_m <= health.lost_chance_m;
    if (believes) state = State::kUncertain;
  }
  if (position_std_m > health.lost_position_std_m || travelled_m > health.lost_travel_m) {
    return State::kLost;
  }
  if (memory_.jumped || position_std_m > health.tracking_position_std_m ||
      std::sqrt(estimate.covariance(2, 2)) > health.tracking_yaw_std_rad ||
      travelled_m > health.tracking_travel_m) {
    state = std::max(state, State::kUncertain);
  }
  return state;
}

std::optional<PoseEstimate> Localizer::At(frames::TimeNs time_ns) const {
  std::optional<PoseEstimate> estimate = history_.At(time_ns);
  if (!estimate) return std::nullopt;
  if (time_ns > history_.corrections().back().estimate.stamp_ns) {
    estimate->state = std::max(estimate->state, Judge(*estimate, memory_.travelled_m));
  }
  return estimate;
}

std::optional<OdometryFrame> Localizer::odometry_frame() const {
  if (!memory_.raw_odometry) return std::nullopt;
  const frames::Odometry& odometry = *memory_.raw_odometry;
  const std::optional<PoseEstimate> now = At(odometry.stamp_ns);
  if (!now || now->state == State::kLost) return std::nullopt;
  return OdometryFrame{odometry.stamp_ns, now->map_from_base * odometry.odom_from_base.Inverse()};
}

std::vector<PoseEstimate> Localizer::Path(frames::TimeNs begin_ns, frames::TimeNs end_ns) const {
  std::vector<PoseEstimate> path;
  for (const Correction& correction : history_.corrections()) {
    const frames::TimeNs stamp_ns = correction.estimate.stamp_ns;
    if (stamp_ns >= begin_ns && stamp_ns <= end_ns) path.push_back(correction.estimate);
  }
  return path;
}

std::optional<frames::TimeNs> Localizer::newest_correction_ns() const {
  if (history_.corrections().empty()) return std::nullopt;
  return history_.corrections().back().estimate.stamp_ns;
}

std::optional<frames::TimeNs> Localizer::newest_odometry_ns() const {
  if (history_.track().empty()) return std::nullopt;
  return history_.track().newest_ns();
}

}  // namespace soundmap::localization
