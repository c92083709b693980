// Three of the rooms that `./run evaluate` measures thirty of, with short drives.

#include <gtest/gtest.h>

#include "tests/acceptance/room_trial.h"

namespace soundmap::acceptance {
namespace {

TEST(Rooms, MostSourcesAreFoundAndFewGhosts) {
  const auto profile = pipeline::ProfileByName("default");
  Summary summary;
  for (const int seed : {2008, 2011, 2017}) {
    SCOPED_TRACE(seed);
    RoomVariant variant;
    variant.seconds = 25.0;
    const auto trial = RandomTrial(seed, variant, ::testing::TempDir());
    ASSERT_TRUE(trial.ok()) << trial.status();
    EXPECT_FALSE(trial->planar());
    const auto result = acceptance::Run(*trial, *profile);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_LT(result->pose_error_m, 0.1);
    summary.Add(*result);
  }
  EXPECT_GE(summary.in_view, 3);
  EXPECT_GE(summary.recall(), 0.5);
  EXPECT_GE(summary.precision(), 0.7);
  EXPECT_LT(summary.ErrorQuantile(0.5), 0.15);
}

}  // namespace
}  // namespace soundmap::acceptance
