// Prints how well the robots of real logs are localized: every seed, every loss.
//   localization_logs [--seeds N] [--trials N] [aces|csail|fr079|relations|start|carried]...

#include <CLI/CLI.hpp>
#include <cstdio>
#include <set>

#include "geometry/angles.h"
#include "localization/log_trials.h"

namespace soundmap::localization {
namespace {

std::shared_ptr<const PreparedPlan> Prepare(const Scene& scene) {
  auto plan = PreparedPlan::Create(scene.config(), scene.plan);
  if (!plan.ok()) throw std::runtime_error(std::string(plan.status().message()));
  return *plan;
}

void PrintTracking(const Scene& scene, int seeds) {
  const auto plan = Prepare(scene);
  int lost = 0;
  double mean_m = 0.0;
  double mean_deg = 0.0;
  for (int seed = 0; seed < seeds; ++seed) {
    const TrackResult r = Track(scene, plan, seed);
    const double yaw_deg = geometry::DegFromRad(r.mean_yaw_rad);
    std::printf(
        "%-16s seed %2d: mean %.3f m, p95 %.3f m, max %.3f m, yaw %.2f deg, tracking %.1f %%, "
        "called lost "
        "%.1f %%, fit %.2f, %lld corrections of %.0f us, lag %.3f s, %lld losses, %lld jumps%s\n",
        scene.name.c_str(), seed, r.mean_m, r.p95_m, r.max_m, yaw_deg, 100.0 * r.tracking_share,
        100.0 * r.lost_share, r.mean_fit, static_cast<long long>(r.counters.corrections),
        r.correction_us, r.laser_lag_s, static_cast<long long>(r.counters.losses),
        static_cast<long long>(r.counters.odometry_jumps), r.diverged() ? "  DIVERGED" : "");
    std::fflush(stdout);
    lost += r.diverged();
    mean_m += r.mean_m / seeds;
    mean_deg += yaw_deg / seeds;
  }
  std::printf("%-16s %d of %d diverged, mean %.3f m, %.2f deg\n", scene.name.c_str(), lost, seeds,
              mean_m, mean_deg);
}

void PrintTrials(const Scene& scene, bool carried, int trials) {
  const auto plan = Prepare(scene);
  const std::vector<StampedPose> path = TrackedPath(scene, plan, 1);
  const auto starts = TrialStarts(scene, path, trials, 16.0, 5);
  const auto ends = TrialStarts(scene, path, trials, 16.0, 6);
  int within_5 = 0;
  int within_10 = 0;
  int wrong = 0;
  for (int i = 0; i < trials; ++i) {
    // A carried robot comes to another part of the way.
    const std::size_t to = starts[i];
    const std::size_t from = carried ? ends[(i + trials / 3) % trials] : to;
    const TrialResult r = RunTrial(scene, plan, path, from, to, 8.0, 15.0, i);
    std::printf(
        "%-8s %s %2d: right after %5.2f m, wrong tracking %.2f m, believed %.2f m, noticed after "
        "%.2f m; late poses "
        "%d: %d right (%.3f m), %d wrong; %lld searches, %lld losses, %lld recoveries, worst call "
        "%.0f us\n",
        scene.name.c_str(), carried ? "carried off" : "unknown start", i, r.until_right_m,
        r.wrong_tracking_m, r.wrong_believed_m, r.noticed_m, r.late_poses, r.late_right,
        r.late_mean_m, r.late_wrong, static_cast<long long>(r.counters.searches),
        static_cast<long long>(r.counters.losses), static_cast<long long>(r.counters.recoveries),
        r.worst_call_us);
    std::fflush(stdout);
    within_5 += r.until_right_m >= 0.0 && r.until_right_m <= 5.0;
    within_10 += r.until_right_m >= 0.0 && r.until_right_m <= 10.0;
    wrong += r.wrong_tracking_m > 2.0;
  }
  std::printf("%-8s %s: %d of %d right within 5 m, %d within 10 m; %d wrong for more than 2 m\n",
              scene.name.c_str(), carried ? "carried off" : "unknown start", within_5, trials,
              within_10, wrong);
}

int Main(int argc, char** argv) {
  CLI::App app("How well the robots of real logs are localized");
  int seeds = 10;
  int trials = 20;
  std::vector<std::string> chosen;
  app.add_option("--seeds", seeds, "Of each tracked log");
  app.add_option("--trials", trials, "Unknown starts, and robots carried off");
  app.add_option("parts", chosen, "aces, csail, fr079, relations, start, carried; default: all");
  CLI11_PARSE(app, argc, argv);
  const std::set<std::string> parts(chosen.begin(), chosen.end());
  const auto wanted = [&](const char* part) { return parts.empty() || parts.count(part) > 0; };
  if (DataFolder().empty()) {
    std::fprintf(stderr, "the test data are not there: set SOUNDMAP_DATA\n");
    return 1;
  }
  const Scene aces = AcesScene();
  if (wanted("aces")) PrintTracking(aces, seeds);
  if (wanted("csail")) PrintTracking(CsailScene(), seeds);
  if (wanted("fr079")) PrintTracking(Building079Scene(), seeds);
  if (wanted("relations")) {
    const auto plan = Prepare(aces);
    for (int seed = 0; seed < std::min(seeds, 3); ++seed) {
      const RelationsResult r =
          Relations(DataFolder() + "/aces/aces.relations", TrackedPath(aces, plan, seed));
      std::printf("aces relations, seed %d: %d, mean %.4f m, %.2f deg\n", seed, r.relations,
                  r.mean_m, geometry::DegFromRad(r.mean_rad));
    }
  }
  if (wanted("start")) PrintTrials(aces, false, trials);
  if (wanted("carried")) PrintTrials(aces, true, trials);
  return 0;
}

}  // namespace
}  // namespace soundmap::localization

int main(int argc, char** argv) { return soundmap::localization::Main(argc, argv); }
