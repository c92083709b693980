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

// From the header of the PNG.
int WidthOf(const std::string& png) {
  int width = 0;
  for (int i = 16; i < 20; ++i) width = width << 8 | static_cast<unsigned char>(png[i]);
  return width;
}

TEST(PlanView, AFloorPlanAloneHasNoLegendOfTheSound) {
  const auto map = SoundMap::Create(DefaultConfig()).value();
  PlanImage plan;
  plan.width = 10;
  plan.height = 10;
  plan.cells.assign(100, 1);
  const auto with = RenderPlanView(*map->TakeSnapshot(), plan, {});
  const auto alone = RenderPlanView(*map->TakeSnapshot(), plan, {}, {.floor_plan_only = true});
  ASSERT_TRUE(with.ok() && alone.ok());
  EXPECT_LT(WidthOf(*alone), WidthOf(*with) - 300);
}

}  // namespace
}  // namespace soundmap::sound_map
