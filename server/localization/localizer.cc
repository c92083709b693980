#include "localization/localizer.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <utility>

#include "absl/strings/str_cat.h"

namespace soundmap::localization {
namespace {

constexpr double kHistory_s = 30.0;

// So long before the first correction the pose is carried back to.
constexpr double kBeforeFirst_s = 1.0;

// Stamps jitter: a motion up to this is no jump, however short the time.
constexpr double kJumpTolerance_m = 0.2;
constexpr double kJumpTolerance_rad = 0.2;

constexpr double kMaxLaserTilt_rad = geometry::RadFromDeg(5.0);
constexpr std::size_t kMaxBeamsOfScan = 20'000;

// Of the valid beams, for refinement and the scan fit.
constexpr int kMaxBeamsOfFit = 1000;

// The scan fit does not rest on fewer than this share of the valid beams.
constexpr double kMinKnownShare = 0.2;

bool IsFinite(const geometry::Pose2& pose) {
  return std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.yaw_rad);
}

double PositionStd(const Eigen::Matrix3d& covariance) {
  return std::sqrt(covariance(0, 0) + covariance(1, 1));
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

double ScanFit(const std::vector<Beam>& beams, const geometry::Pose2& map_from_base,
               const BeamCaster& caster, const HealthConfig& config) {
  if (beams.empty()) return 0.0;
  const Eigen::Rotation2Dd rotation(map_from_base.yaw_rad);
  std::vector<Ray> rays;
  rays.reserve(beams.size());
  for (const Beam& beam : beams) {
    const Eigen::Vector2f origin =
        (Eigen::Vector2d(map_from_base.x_m, map_from_base.y_m) + rotation * beam.origin_in_base_m)
            .cast<float>();
    const Eigen::Vector2f direction = (rotation * beam.direction_in_base).cast<float>();
    rays.push_back({origin.x(), origin.y(), direction.x(), direction.y()});
  }
  std::vector<Return> expected(rays.size());
  caster.Cast(rays, expected);
  int known = 0;
  int explained = 0;
  for (std::size_t i = 0; i < beams.size(); ++i) {
    if (expected[i].ending != Ending::kWall) continue;
    ++known;
    const double tolerance_m =
        config.fit_tolerance_m + config.fit_tolerance_share * expected[i].range_m;
    explained += std::abs(beams[i].range_m - expected[i].range_m) <= tolerance_m;
  }
  return explained / std::max<double>(known, kMinKnownShare * static_cast<double>(beams.size()));
}

}  // namespace

absl::StatusOr<Localizer> Localizer::Create(std::shared_ptr<const PreparedPlan> plan,
                                            const frames::Calibration& calibration,
                                            const std::optional<InitialPose>& initial_pose,
                                            std::uint64_t seed) {
  if (absl::Status status = CheckLaser(calibration); !status.ok()) return status;
  if (!initial_pose) {
    return absl::FailedPreconditionError(
        "the robot has no initial pose: localization cannot start from an unknown place");
  }
  const geometry::Pose2& start = initial_pose->map_from_base;
  if (!IsFinite(start) ||
      !(initial_pose->position_std_m >= 0.0 && initial_pose->position_std_m <= 1000.0) ||
      !(initial_pose->yaw_std_rad >= 0.0 && initial_pose->yaw_std_rad <= geometry::kPi)) {
    return absl::InvalidArgumentError(
        "the initial pose or its spread is not finite, or the spread is out of range");
  }
  if (!plan->bounds_in_map_m.contains(Eigen::Vector2d(start.x_m, start.y_m))) {
    return absl::InvalidArgumentError(absl::StrCat("the initial pose (", start.x_m, ", ", start.y_m,
                                                   ") lies outside the floor plan"));
  }
  const int count = plan->config.particles;
  Localizer localizer(std::move(plan), calibration);
  localizer.engine_.seed(seed);
  localizer.memory_.particles = Scatter(start, initial_pose->position_std_m,
                                        initial_pose->yaw_std_rad, count, localizer.engine_);
  return localizer;
}

absl::StatusOr<Localizer> Localizer::Restore(std::shared_ptr<const PreparedPlan> plan,
                                             const frames::Calibration& calibration,
                                             const LocalizerState& state) {
  if (absl::Status status = CheckLaser(calibration); !status.ok()) return status;
  const absl::Status refused =
      absl::InvalidArgumentError("the saved state of the localization does not fit this site");
  const Config& config = plan->config;
  Localizer localizer(plan, calibration);
  localizer.memory_ = state;
  localizer.memory_.engine.clear();
  localizer.memory_.odometry.clear();
  localizer.memory_.waiting_scans.clear();
  localizer.memory_.corrections.clear();

  if (static_cast<int>(state.particles.size()) != config.particles) return refused;
  for (const Particle& particle : state.particles) {
    if (!IsFinite(particle.map_from_base) || !(particle.log_weight <= 1e-6)) return refused;
  }
  std::istringstream engine(state.engine);
  if (!(engine >> localizer.engine_)) return refused;
  for (const frames::Odometry& odometry : state.odometry) {
    if (!localizer.track_.Add(odometry)) return refused;
  }
  if (state.raw_odometry.has_value() != !state.odometry.empty() ||
      state.odom_from_particles.has_value() != state.raw_odometry.has_value() ||
      static_cast<int>(state.waiting_scans.size()) > config.max_waiting_scans) {
    return refused;
  }
  localizer.waiting_scans_.assign(state.waiting_scans.begin(), state.waiting_scans.end());
  localizer.corrections_.assign(state.corrections.begin(), state.corrections.end());
  return localizer;
}

LocalizerState Localizer::state() const {
  LocalizerState state = memory_;
  std::ostringstream engine;
  engine << engine_;
  state.engine = engine.str();
  state.odometry.assign(track_.entries().begin(), track_.entries().end());
  state.waiting_scans.assign(waiting_scans_.begin(), waiting_scans_.end());
  state.corrections.assign(corrections_.begin(), corrections_.end());
  return state;
}

std::vector<PoseEstimate> Localizer::Add(const frames::Odometry& odometry) {
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
    odom_from_base = track_.entries().back().odom_from_base;
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
  }
  memory_.raw_odometry = odometry;
  track_.Add({odometry.stamp_ns, odom_from_base});
  while (corrections_.size() > 2 && corrections_[1].estimate.stamp_ns <
                                        odometry.stamp_ns - frames::NsFromSeconds(kHistory_s)) {
    corrections_.pop_front();
  }
  return Drain();
}

std::vector<PoseEstimate> Localizer::Add(const frames::LaserScan& scan) {
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
  if (track_.empty()) return corrections;
  while (!waiting_scans_.empty()) {
    const frames::LaserScan& scan = waiting_scans_.front();
    const frames::TimeNs first_beam_ns =
        scan.stamp_ns - frames::NsFromSeconds(plan_->config.laser_lag_s);
    const frames::TimeNs last_beam_ns =
        first_beam_ns + frames::NsFromSeconds(static_cast<double>(scan.range_m.size()) *
                                              calibration_.laser_time_increment_s);
    if (first_beam_ns < track_.oldest_ns()) {
      ++memory_.counters.scans_ignored;
    } else if (last_beam_ns > track_.newest_ns()) {
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
      MiddleOf(scan, calibration_.laser_time_increment_s, config.laser_lag_s);
  const geometry::Pose2 odom_from_base = *track_.At(time_ns);
  const geometry::Pose2 moved = memory_.odom_from_particles->Inverse() * odom_from_base;
  const bool due = corrections_.empty() || memory_.jumped ||
                   std::hypot(moved.x_m, moved.y_m) >= config.correction_distance_m ||
                   std::abs(moved.yaw_rad) >= config.correction_turn_rad;
  if (due) {
    const auto beams =
        ValidBeams(scan, calibration_, config.laser_lag_s, config.min_range_m, track_);
    if (!beams || static_cast<int>(beams->size()) < config.min_beams) {
      ++memory_.counters.scans_empty;
      return std::nullopt;
    }
    memory_.considered_until_ns = time_ns;
    return Correct(time_ns, odom_from_base, *beams);
  }
  memory_.considered_until_ns = time_ns;
  return std::nullopt;
}

PoseEstimate Localizer::Correct(frames::TimeNs time_ns, const geometry::Pose2& odom_from_base,
                                const std::vector<Beam>& beams) {
  const Config& config = plan_->config;
  std::vector<Particle>& particles = memory_.particles;

  Predict(MotionModel(config.motion, memory_.odom_from_particles->Inverse() * odom_from_base),
          particles, engine_);
  if (memory_.jumped) {
    std::normal_distribution<double> normal;
    for (Particle& particle : particles) {
      particle.map_from_base.x_m += config.jump_position_std_m * normal(engine_);
      particle.map_from_base.y_m += config.jump_position_std_m * normal(engine_);
      particle.map_from_base.yaw_rad = geometry::NormalizeAngle(
          particle.map_from_base.yaw_rad + config.jump_yaw_std_rad * normal(engine_));
    }
  }
  localization::Correct(Subsample(beams, config.beams), plan_->caster, plan_->model,
                        config.tempering, particles);

  Distribution pose = Summarize(particles);
  const std::vector<Beam> fit_beams = Subsample(beams, kMaxBeamsOfFit);
  if (config.refinement.enabled) {
    if (const auto refined = plan_->matcher.Match(fit_beams, pose)) pose = *refined;
  }

  PoseEstimate estimate;
  estimate.stamp_ns = time_ns;
  estimate.map_from_base = pose.mean;
  estimate.covariance = pose.covariance;
  estimate.effective_particles = EffectiveParticles(particles);
  estimate.scan_fit = ScanFit(fit_beams, pose.mean, plan_->caster, config.health);
  memory_.mean_fit =
      corrections_.empty()
          ? estimate.scan_fit
          : memory_.mean_fit + (estimate.scan_fit - memory_.mean_fit) / config.health.fit_memory;
  memory_.misfit_m += memory_.travelled_m;
  if (memory_.mean_fit >= config.health.tracking_fit) {
    memory_.misfit_m = 0.0;
    memory_.misfit = false;
  } else if (memory_.mean_fit < config.health.lost_fit ||
             memory_.misfit_m > config.health.lost_misfit_m) {
    memory_.misfit = true;
  }
  estimate.state = Judge(estimate.covariance, estimate.scan_fit, 0.0);

  if (estimate.effective_particles <
      config.resample_below * static_cast<double>(particles.size())) {
    particles = Resample(particles, engine_);
    ++memory_.counters.resamplings;
  }
  ++memory_.counters.corrections;
  memory_.odom_from_particles = odom_from_base;
  memory_.jumped = false;
  memory_.travelled_m = 0.0;
  corrections_.push_back({estimate, odom_from_base});
  return estimate;
}

State Localizer::Judge(const Eigen::Matrix3d& covariance, double fit, double travelled_m) const {
  const HealthConfig& health = plan_->config.health;
  const double position_std_m = PositionStd(covariance);
  if (memory_.misfit || position_std_m > health.lost_position_std_m ||
      travelled_m > health.lost_travel_m) {
    return State::kLost;
  }
  if (std::min(fit, memory_.mean_fit) < health.tracking_fit || memory_.jumped ||
      position_std_m > health.tracking_position_std_m ||
      std::sqrt(covariance(2, 2)) > health.tracking_yaw_std_rad ||
      travelled_m > health.tracking_travel_m) {
    return State::kUncertain;
  }
  return State::kTracking;
}

std::optional<PoseEstimate> Localizer::At(frames::TimeNs time_ns) const {
  const auto odom_from_base = track_.At(time_ns);
  if (!odom_from_base || corrections_.empty()) return std::nullopt;
  const auto carried = [&](const Correction& correction) {
    return correction.estimate.map_from_base *
           (correction.odom_from_base.Inverse() * *odom_from_base);
  };
  const auto after = std::find_if(
      corrections_.begin(), corrections_.end(),
      [&](const Correction& correction) { return correction.estimate.stamp_ns >= time_ns; });

  if (after == corrections_.end()) {
    const Correction& newest = corrections_.back();
    const MotionModel motion(plan_->config.motion,
                             newest.odom_from_base.Inverse() * *odom_from_base);
    PoseEstimate estimate = newest.estimate;
    estimate.map_from_base = carried(newest);
    estimate.covariance =
        motion.Propagate(newest.estimate.map_from_base, newest.estimate.covariance);
    estimate.state = std::max(estimate.state,
                              Judge(estimate.covariance, estimate.scan_fit, memory_.travelled_m));
    estimate.stamp_ns = time_ns;
    return estimate;
  }
  if (after == corrections_.begin()) {
    const double before_s = frames::SecondsFromNs(after->estimate.stamp_ns - time_ns);
    if (before_s > kBeforeFirst_s) return std::nullopt;
    PoseEstimate estimate = after->estimate;
    estimate.map_from_base = carried(*after);
    estimate.stamp_ns = time_ns;
    return estimate;
  }
  const Correction& before = *std::prev(after);
  const double fraction = static_cast<double>(time_ns - before.estimate.stamp_ns) /
                          static_cast<double>(after->estimate.stamp_ns - before.estimate.stamp_ns);
  PoseEstimate estimate;
  estimate.stamp_ns = time_ns;
  estimate.map_from_base = geometry::Interpolate(carried(before), carried(*after), fraction);
  estimate.covariance =
      (1.0 - fraction) * before.estimate.covariance + fraction * after->estimate.covariance;
  estimate.effective_particles =
      std::min(before.estimate.effective_particles, after->estimate.effective_particles);
  estimate.scan_fit = std::min(before.estimate.scan_fit, after->estimate.scan_fit);
  estimate.state = std::max(before.estimate.state, after->estimate.state);
  return estimate;
}

std::optional<frames::TimeNs> Localizer::newest_correction_ns() const {
  if (corrections_.empty()) return std::nullopt;
  return corrections_.back().estimate.stamp_ns;
}

std::optional<frames::TimeNs> Localizer::newest_odometry_ns() const {
  if (track_.empty()) return std::nullopt;
  return track_.newest_ns();
}

}  // namespace soundmap::localization
