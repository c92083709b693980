#include "localization/hypotheses.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"
#include "localization/health.h"
#include "localization/look_back.h"

namespace soundmap::localization {
namespace {

// A drive of no length counts this much, so that the first scan has a weight.
constexpr double kMinDriven_m = 0.02;

bool SamePlace(const geometry::Pose2& a, const geometry::Pose2& b, const SearchConfig& config) {
  return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m) < config.apart_m &&
         std::abs(geometry::NormalizeAngle(a.yaw_rad - b.yaw_rad)) < config.apart_rad;
}

geometry::Pose2 PlaceOf(const Hypothesis& hypothesis) {
  return Summarize(hypothesis.particles).mean;
}

}  // namespace

void Hypotheses::Weigh(const KeptScan& scan, double driven_m, Hypothesis& hypothesis,
                       std::mt19937_64& engine) const {
  const Config& config = plan_.config;
  const double log_likelihood =
      Correct(scan.beams, plan_.caster, plan_.model, config.tempering, hypothesis.particles) /
      (config.tempering * static_cast<double>(scan.beams.size()));
  const double fit = ScanFit(scan.beams, PlaceOf(hypothesis), plan_.caster, config.health);
  const double share = std::max(driven_m, kMinDriven_m);
  hypothesis.weight =
      hypothesis.weight * std::exp(-share / config.search.evidence_travel_m) + share;
  const double part = share / hypothesis.weight;
  hypothesis.evidence += part * (log_likelihood - hypothesis.evidence);
  hypothesis.fit += part * (fit - hypothesis.fit);
  const bool is_first = hypothesis.weight == share;
  const double recent_part =
      is_first ? 1.0 : 1.0 - std::exp(-share / config.search.recent_travel_m);
  hypothesis.recent += recent_part * (log_likelihood - hypothesis.recent);
  if (EffectiveParticles(hypothesis.particles) <
      config.resample_below * static_cast<double>(hypothesis.particles.size())) {
    hypothesis.particles =
        Resample(hypothesis.particles, static_cast<int>(hypothesis.particles.size()), engine);
  }
}

void Hypotheses::Advance(const KeptScan& scan, const geometry::Pose2& moved,
                         std::mt19937_64& engine) {
  const MotionModel motion(plan_.config.motion, moved);
  for (Hypothesis& hypothesis : all_) {
    Predict(motion, hypothesis.particles, engine);
    if (scan.jumped) Spread(plan_.config, hypothesis.particles, engine);
    Weigh(scan, std::hypot(moved.x_m, moved.y_m), hypothesis, engine);
  }
  Sort();
}

void Hypotheses::TakeUp(const std::vector<Candidate>& candidates,
                        const std::vector<const KeptScan*>& recent, int sectors_searched,
                        std::mt19937_64& engine) {
  const SearchConfig& search = plan_.config.search;
  std::vector<geometry::Pose2> known;
  for (const Hypothesis& hypothesis : all_) known.push_back(PlaceOf(hypothesis));
  for (const Candidate& candidate : candidates) {
    if (std::any_of(known.begin(), known.end(), [&](const geometry::Pose2& place) {
          return SamePlace(place, candidate.map_from_base, search);
        })) {
      continue;
    }
    const geometry::Pose2 begin = candidate.map_from_base *
                                  recent.back()->odom_from_base.Inverse() *
                                  recent.front()->odom_from_base;
    Hypothesis hypothesis;
    hypothesis.taken_up_at = sectors_searched;
    hypothesis.particles =
        Scatter(begin, std::max(search.scatter_m, 0.5 * plan_.search.tolerance_m()),
                search.scatter_rad, search.hypothesis_particles, engine);
    Weigh(*recent.front(), 0.0, hypothesis, engine);
    for (std::size_t i = 1; i < recent.size(); ++i) {
      const geometry::Pose2 moved =
          recent[i - 1]->odom_from_base.Inverse() * recent[i]->odom_from_base;
      Predict(MotionModel(plan_.config.motion, moved), hypothesis.particles, engine);
      if (recent[i]->jumped) Spread(plan_.config, hypothesis.particles, engine);
      Weigh(*recent[i], std::hypot(moved.x_m, moved.y_m), hypothesis, engine);
    }
    known.push_back(PlaceOf(hypothesis));
    all_.push_back(std::move(hypothesis));
  }
  Sort();
}

// Best first; of two at one place the better one stays, and none that is out of the question.
void Hypotheses::Sort() {
  const SearchConfig& search = plan_.config.search;
  std::stable_sort(all_.begin(), all_.end(), [](const Hypothesis& a, const Hypothesis& b) {
    return a.evidence > b.evidence;
  });
  std::vector<Hypothesis> kept;
  std::vector<geometry::Pose2> places;
  for (Hypothesis& hypothesis : all_) {
    if (static_cast<int>(kept.size()) >= search.max_hypotheses ||
        (!kept.empty() && hypothesis.evidence < kept.front().evidence - search.give_up_margin)) {
      break;
    }
    const geometry::Pose2 place = PlaceOf(hypothesis);
    if (std::any_of(places.begin(), places.end(), [&](const geometry::Pose2& better) {
          return SamePlace(better, place, search);
        })) {
      continue;
    }
    places.push_back(place);
    kept.push_back(std::move(hypothesis));
  }
  all_ = std::move(kept);
}

const Hypothesis* Hypotheses::At(const geometry::Pose2& place) const {
  for (const Hypothesis& hypothesis : all_) {
    if (SamePlace(PlaceOf(hypothesis), place, plan_.config.search)) return &hypothesis;
  }
  return nullptr;
}

double Hypotheses::lead() const {
  if (all_.size() < 2) return plan_.config.search.give_up_margin;
  return all_[0].evidence - all_[1].evidence;
}

bool Hypotheses::IsUnambiguous(int sectors_searched) const {
  const Config& config = plan_.config;
  if (all_.empty()) return false;
  const Hypothesis& best = all_.front();
  const bool leads_now = std::all_of(all_.begin() + 1, all_.end(), [&](const Hypothesis& other) {
    return other.recent <= best.recent - config.search.min_lead;
  });
  const Distribution pose = localization::Summarize(best.particles);
  return leads_now && sectors_searched >= best.taken_up_at + config.search.sectors &&
         lead() >= config.search.min_lead && lead() * best.weight >= config.search.min_lead_m &&
         best.fit >= config.search.min_fit && best.weight >= config.search.min_travel_m &&
         std::sqrt(pose.covariance(0, 0) + pose.covariance(1, 1)) <=
             config.health.tracking_position_std_m;
}

Distribution Hypotheses::Summarize() const {
  Distribution distribution = localization::Summarize(all_.front().particles);
  double sum = 0.0;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const Hypothesis& hypothesis : all_) {
    const double weight =
        std::exp((hypothesis.evidence - all_.front().evidence) / plan_.config.search.min_lead);
    const Distribution place = localization::Summarize(hypothesis.particles);
    const Eigen::Vector3d away(
        place.mean.x_m - distribution.mean.x_m, place.mean.y_m - distribution.mean.y_m,
        geometry::NormalizeAngle(place.mean.yaw_rad - distribution.mean.yaw_rad));
    covariance += weight * (place.covariance + away * away.transpose());
    sum += weight;
  }
  distribution.covariance = covariance / sum;
  return distribution;
}

}  // namespace soundmap::localization
