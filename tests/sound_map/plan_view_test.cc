#include "sound_map/plan_view.h"

#include <gtest/gtest.h>

#include "sound_map/sound_map.h"

namespace soundmap::sound_map {
namespace {

TEST(PlanView, IsAPngThatDependsOnTheMap) {
  auto map = SoundMap::Create(DefaultConfig()).value();
  const auto empty = RenderPlanView(*map->TakeSnapshot(), std::nullopt, {});
  ASSERT_TRUE(empty.ok()) << empty.status();
  EXPECT_EQ(empty->substr(0, 8), "\x89PNG\r\n\x1a\n");
  EvidenceScan scan;
  for (int i = 0; i < 40; ++i) {
    scan.end_points.push_back({{static_cast<std::uint16_t>(32768 + i), 32768, 32768}, 0.9f});
  }
  ASSERT_TRUE(map->Apply(scan).ok());
  const auto some = RenderPlanView(*map->TakeSnapshot(), std::nullopt, {});
  ASSERT_TRUE(some.ok());
  EXPECT_NE(*some, *empty);
  EXPECT_EQ(*RenderPlanView(*map->TakeSnapshot(), std::nullopt, {}), *some);
}

TEST(PlanView, APlanWhoseCellsDoNotFitIsRefused) {
  const auto map = SoundMap::Create(DefaultConfig()).value();
  PlanImage plan;
  plan.width = 10;
  plan.height = 10;
  plan.cells.assign(99, 1);
  EXPECT_TRUE(absl::IsInvalidArgument(RenderPlanView(*map->TakeSnapshot(), plan, {}).status()));
  plan.cells.assign(100, 1);
  EXPECT_TRUE(RenderPlanView(*map->TakeSnapshot(), plan, {}).ok());
}

}  // namespace
}  // namespace soundmap::sound_map
