#pragma once

#include <random>
#include <vector>

#include "localization/global_search.h"
#include "localization/kept_scan.h"
#include "localization/particle_filter.h"
#include "localization/prepared_plan.h"

namespace soundmap::localization {

// One place where a lost robot may be: a small particle filter of its own.
struct Hypothesis {
  std::vector<Particle> particles;
  // Means over the newest scans, older ones fading out over evidence_travel_m.
  double evidence = 0.0;  // logarithm of a beam's likelihood
  double fit = 0.0;       // scan fit
  double recent = 0.0;    // as `evidence`, over recent_travel_m
  double weight =
      0.0;  // of the first two means: how much was driven for them, fading likewise, in m
  int taken_up_at = 0;  // sectors that had been searched

  bool operator==(const Hypothesis&) const = default;
};

// The mixture of all of them. All stand at the time of one kept scan, the newest.
//
// The evidence of two hypotheses compares, whether they are old or new: a new one is first taken
// through the recent scans. The best one wins once it has been driven with, explains the scans, and
// no other place explains them nearly as well.
class Hypotheses {
 public:
  Hypotheses(const PreparedPlan& plan, std::vector<Hypothesis> all)
      : plan_(plan), all_(std::move(all)) {}

  // Carries all to a scan and weighs them with it. `moved` since the scan before.
  void Advance(const KeptScan& scan, const geometry::Pose2& moved, std::mt19937_64& engine);

  // Takes up new places at the time of the newest of `recent` (oldest first), unless a hypothesis
  // is there already. `sectors_searched` so far.
  void TakeUp(const std::vector<Candidate>& candidates, const std::vector<const KeptScan*>& recent,
              int sectors_searched, std::mt19937_64& engine);

  // The best hypothesis; null when there is none.
  const Hypothesis* best() const { return all_.empty() ? nullptr : &all_.front(); }
  // How much less a beam's logarithm of the likelihood is at the best other place; the configured
  // margin and more when there is none.
  double lead() const;
  // The best one was driven with, explains the scans and leads, also by the newest scans alone (a
  // place where something stood in the way at first may be the right one), and since it is known
  // the search has gone once around: its twin would be known, too.
  bool IsUnambiguous(int sectors_searched) const;
  // The best at a place; null when there is none.
  const Hypothesis* At(const geometry::Pose2& place) const;

  // All places together, each by its evidence, around the best.
  Distribution Summarize() const;

  const std::vector<Hypothesis>& all() const { return all_; }

 private:
  void Weigh(const KeptScan& scan, double driven_m, Hypothesis& hypothesis,
             std::mt19937_64& engine) const;
  void Sort();

  const PreparedPlan& plan_;
  std::vector<Hypothesis> all_;  // best first
};

}  // namespace soundmap::localization
