// What a Localizer does while its robot is lost.

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "localization/localizer.h"

namespace soundmap::localization {
namespace {

// Kept while the robot knows where it is: they hold the stretch before a loss is noticed.
constexpr std::size_t kKeptWhileTracking = 100;

// Driven between two sectors of a search that has found no rival.
constexpr double kUnrivalledStep_m = 0.5;

std::vector<Eigen::Vector2d> EndsInBase(const std::vector<const KeptScan*>& scans, int max_count) {
  std::size_t all = 0;
  for (const KeptScan* scan : scans) all += scan->beams.size();
  const geometry::Pose2 newest_from_odom = scans.back()->odom_from_base.Inverse();
  std::vector<Eigen::Vector2d> ends;
  std::size_t seen = 0;
  for (const KeptScan* scan : scans) {
    const geometry::Pose2 newest_from_then = newest_from_odom * scan->odom_from_base;
    const Eigen::Rotation2Dd rotation(newest_from_then.yaw_rad);
    const Eigen::Vector2d then(newest_from_then.x_m, newest_from_then.y_m);
    for (const Beam& beam : scan->beams) {
      const std::size_t before = seen * max_count / all;
      ++seen;
      if (all > static_cast<std::size_t>(max_count) && seen * max_count / all == before) continue;
      ends.push_back(then +
                     rotation * (beam.origin_in_base_m + beam.range_m * beam.direction_in_base));
    }
  }
  return ends;
}

}  // namespace

// From the first of the newest scans that fit worse than usual, the robot may be elsewhere.
void Localizer::BeginSearch() {
  const double usual_fit = std::max(plan_->config.health.tracking_fit,
                                    plan_->config.health.usual_share * health_.slow_fit);
  memory_.search_from_ns = kept_scans_.back().stamp_ns;
  int fitting = 0;
  for (auto earlier = history_.corrections().rbegin();
       earlier != history_.corrections().rend() && fitting < 2 &&
       earlier->estimate.stamp_ns >= kept_scans_.front().stamp_ns;
       ++earlier) {
    if (earlier->estimate.scan_fit < usual_fit) {
      memory_.search_from_ns = earlier->estimate.stamp_ns;
      fitting = 0;
    } else {
      ++fitting;
    }
  }
  memory_.searching = true;
  memory_.sectors_searched = 0;
  memory_.unrivalled = false;
  memory_.rivalled = false;
}

// Looks through the next sector and weighs the places. `own`: what the filter says, if there is
// one. Returns the estimate to publish.
std::optional<PoseEstimate> Localizer::Search(const KeptScan& scan, const std::vector<Beam>& beams,
                                              const geometry::Pose2& moved,
                                              const std::optional<PoseEstimate>& own) {
  const SearchConfig& config = plan_->config.search;
  Hypotheses hypotheses(*plan_, std::move(memory_.hypotheses));
  hypotheses.Advance(scan, moved, engine_);
  const std::vector<const KeptScan*> recent = RecentScans();
  std::vector<Candidate> candidates;
  if (own) candidates.push_back({own->map_from_base, 1.0});
  memory_.since_sector_m += std::hypot(moved.x_m, moved.y_m);
  // Once all was searched and nothing speaks against the robot's place, now and then is enough.
  if (!memory_.unrivalled || memory_.since_sector_m >= kUnrivalledStep_m) {
    const auto found = plan_->search.Search(EndsInBase(recent, config.max_points),
                                            memory_.sectors_searched % config.sectors);
    candidates.insert(candidates.end(), found.begin(), found.end());
    ++memory_.sectors_searched;
    ++memory_.counters.searches;
    memory_.since_sector_m = 0.0;
  }
  hypotheses.TakeUp(candidates, recent, memory_.sectors_searched, engine_);
  memory_.hypotheses = hypotheses.all();
  const bool complete = memory_.sectors_searched >= config.sectors;
  const Hypothesis* best = hypotheses.best();

  if (own) {
    const Hypothesis* own_place = hypotheses.At(own->map_from_base);
    const bool is_outdone =
        own_place != best &&
        (own_place == nullptr ||
         (best->evidence - own_place->evidence) * best->weight >= config.carried_lead_m);
    // Somewhere on a whole floor plan chance explains more than an outdated map does at the right
    // place, but less than the map usually does.
    const bool is_clear = is_outdone && best->fit > health_.mean_fit &&
                          hypotheses.IsUnambiguous(memory_.sectors_searched);
    if (is_clear && best->fit >= plan_->config.health.usual_share * health_.slow_fit) {
      return MoveTo(*best, scan, beams);
    }
    memory_.rivalled = is_clear || (is_outdone && best->fit >= health_.slow_fit);
    memory_.unrivalled = complete && own_place != nullptr && own_place == best &&
                         hypotheses.lead() >= config.min_lead;
    PoseEstimate estimate = *own;
    estimate.state = Judge(estimate, 0.0);
    if (estimate.state == State::kLost) {
      BeLost();
    } else if (complete && own_place != nullptr && own_place == best &&
               best->weight >= config.min_travel_m &&
               !health_.IsDoubtful(own->scan_fit, plan_->config.health)) {
      memory_.searching = false;
      memory_.hypotheses.clear();
      estimate.state = Judge(estimate, 0.0);
    }
    if (estimate.state != State::kLost && memory_.lost_since_ns && !memory_.look_back) {
      BeginLookBackFrom(estimate);
    }
    return estimate;
  }

  if (best == nullptr) return std::nullopt;
  if (hypotheses.IsUnambiguous(memory_.sectors_searched)) return MoveTo(*best, scan, beams);
  const Distribution guess = hypotheses.Summarize();
  PoseEstimate estimate;
  estimate.stamp_ns = scan.stamp_ns;
  estimate.map_from_base = guess.mean;
  estimate.covariance = guess.covariance;
  estimate.effective_particles = EffectiveParticles(best->particles);
  estimate.scan_fit = ScanFit(beams, guess.mean, plan_->caster, plan_->config.health);
  estimate.state = State::kLost;
  return estimate;
}

// From the last scan that fitted on, unless that is known already.
void Localizer::BeLost() {
  if (memory_.look_back) ContinueLookBack(std::numeric_limits<int>::max());
  if (memory_.lost_since_ns) return;
  memory_.lost_since_ns = memory_.search_from_ns;
  for (auto earlier = history_.corrections().rbegin(); earlier != history_.corrections().rend();
       ++earlier) {
    if (earlier->estimate.stamp_ns < memory_.search_from_ns) {
      // Up to it all is final.
      memory_.lost_since_ns = earlier->estimate.stamp_ns + 1;
      break;
    }
  }
  history_.MarkLost(*memory_.lost_since_ns);
  ++memory_.counters.losses;
}

PoseEstimate Localizer::MoveTo(const Hypothesis& place, const KeptScan& scan,
                               const std::vector<Beam>& beams) {
  BeLost();
  const double fit = place.fit;
  memory_.particles = Resample(place.particles, plan_->config.particles, engine_);
  memory_.hypotheses.clear();
  memory_.searching = false;
  PoseEstimate estimate = Estimate(*plan_, scan.stamp_ns, beams, memory_.particles);
  health_.Begin(fit);
  memory_.jumped = false;
  estimate.state = Judge(estimate, 0.0);
  BeginLookBackFrom(estimate);
  return estimate;
}

void Localizer::BeginLookBackFrom(const PoseEstimate& estimate) {
  ++memory_.counters.recoveries;
  memory_.look_back =
      BeginLookBack(memory_.particles, {estimate, kept_scans_.back().odom_from_base});
}

// The scans of the last metres, oldest first, as far back as they are of this place and the
// odometry held.
std::vector<const KeptScan*> Localizer::RecentScans() const {
  const SearchConfig& config = plan_->config.search;
  std::vector<const KeptScan*> recent = {&kept_scans_.back()};
  double driven_m = 0.0;
  double since_m = 0.0;
  for (auto later = kept_scans_.rbegin(); std::next(later) != kept_scans_.rend(); ++later) {
    const KeptScan& scan = *std::next(later);
    const geometry::Pose2 moved = scan.odom_from_base.Inverse() * later->odom_from_base;
    const double step_m = std::hypot(moved.x_m, moved.y_m);
    driven_m += step_m;
    since_m += step_m;
    if (later->jumped || scan.stamp_ns < memory_.search_from_ns || driven_m > config.window_m) {
      break;
    }
    if (since_m >= config.window_step_m) {
      recent.push_back(&scan);
      since_m = 0.0;
    }
  }
  std::reverse(recent.begin(), recent.end());
  return recent;
}

void Localizer::Keep(KeptScan scan) {
  kept_scans_.push_back(std::move(scan));
  // A robot that searches may learn that it has been elsewhere since the search began.
  const auto limit = memory_.lost_since_ns || memory_.searching
                         ? static_cast<std::size_t>(plan_->config.search.max_kept_scans)
                         : kKeptWhileTracking;
  while (kept_scans_.size() > limit) {
    if (!memory_.lost_since_ns) {
      kept_scans_.pop_front();
      continue;
    }
    if (kept_scans_.front().stamp_ns >= *memory_.lost_since_ns) {
      ++memory_.counters.scans_given_up;
    }
    kept_scans_.pop_front();
    memory_.lost_since_ns = std::max(*memory_.lost_since_ns, kept_scans_.front().stamp_ns);
  }
}

void Localizer::ContinueLookBack(int max_scans) {
  LookBack& look_back = *memory_.look_back;
  if (Continue(*plan_, kept_scans_, *memory_.lost_since_ns, max_scans, engine_, look_back)) return;
  const frames::TimeNs end_ns = look_back.found.front().estimate.stamp_ns;
  std::reverse(look_back.found.begin(), look_back.found.end());
  history_.Replace(*memory_.lost_since_ns, end_ns, look_back.found);
  learnt_since_ns_ = std::min(*memory_.lost_since_ns, learnt_since_ns_.value_or(end_ns));
  memory_.look_back.reset();
  memory_.lost_since_ns.reset();
}

}  // namespace soundmap::localization
