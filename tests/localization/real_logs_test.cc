// Real robots in real buildings, a few minutes of them: tests/acceptance/localization_logs.cc takes
// more seeds and whole logs.

#include <gtest/gtest.h>

#include <algorithm>

#include "geometry/angles.h"
#include "log_trials.h"

namespace soundmap::localization {
namespace {

class RealLogs : public testing::Test {
 protected:
  void SetUp() override {
    if (DataFolder().empty()) GTEST_SKIP() << "the shared test data are not there";
  }

  static std::shared_ptr<const PreparedPlan> Prepare(const Scene& scene) {
    auto plan = PreparedPlan::Create(scene.config(), scene.plan);
    EXPECT_TRUE(plan.ok()) << plan.status();
    return *plan;
  }
};

TEST_F(RealLogs, CsailIsTracked) {
  const Scene scene = CsailScene();
  const TrackResult result = Track(scene, Prepare(scene), 1);
  EXPECT_GT(result.poses, 380);
  EXPECT_LT(result.mean_m, 0.05);
  EXPECT_LT(result.mean_yaw_rad, geometry::RadFromDeg(0.9));
  EXPECT_FALSE(result.diverged());
  EXPECT_GT(result.tracking_share, 0.85);
}

// Its odometry never says that the robot drives back, and half of the furniture has moved.
TEST_F(RealLogs, AChangedBuildingIsTracked) {
  const Scene scene = Building079Scene();
  for (std::uint64_t seed = 0; seed < 2; ++seed) {
    const TrackResult result = Track(scene, Prepare(scene), seed);
    EXPECT_GT(result.poses, 600);
    EXPECT_LT(result.mean_m, 0.20);
    EXPECT_FALSE(result.diverged());
    EXPECT_LT(result.lost_share, 0.05);
  }
}

TEST_F(RealLogs, AcesIsTrackedAndFoundAgain) {
  const Scene scene = AcesScene();
  const auto plan = Prepare(scene);
  const std::vector<StampedPose> path = TrackedPath(scene, plan, 1);
  const RelationsResult relations = Relations(DataFolder() + "/aces/aces.relations", path);
  EXPECT_GT(relations.relations, 1200);
  EXPECT_LT(relations.mean_m, 0.045);

  constexpr int kTrials = 5;
  const auto starts = TrialStarts(scene, path, kTrials, 16.0, 11);
  const auto ends = TrialStarts(scene, path, kTrials, 16.0, 12);
  int right = 0;
  for (int i = 0; i < kTrials; ++i) {
    for (const std::size_t from : {starts[i], ends[(i + 2) % kTrials]}) {
      const TrialResult result = RunTrial(scene, plan, path, from, starts[i], 8.0, 12.0, i);
      right += result.until_right_m >= 0.0 && result.until_right_m <= 10.0;
      EXPECT_LT(result.wrong_tracking_m, 2.0);
      EXPECT_LT(result.late_wrong, 0.05 * result.late_poses);
    }
  }
  EXPECT_GE(right, 9);
}

}  // namespace
}  // namespace soundmap::localization
