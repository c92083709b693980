#include "sources/simulation/ray_caster.h"

#include <gtest/gtest.h>

#include <random>

namespace soundmap::simulation {
namespace {

const Eigen::Vector3d kRoom(6.0, 5.0, 2.5);

bool Inside(const Box& box, const Eigen::Vector3d& point) {
  return (point.array() >= box.min_m.array()).all() && (point.array() <= box.max_m.array()).all();
}

struct Setting {
  std::vector<Box> furniture, people;
  Eigen::Vector3d origin, direction;
};

Setting RandomSetting(std::mt19937& engine) {
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  const auto point = [&] {
    return Eigen::Vector3d(kRoom.x() * uniform(engine), kRoom.y() * uniform(engine),
                           kRoom.z() * uniform(engine));
  };
  Setting setting;
  for (int i = 0; i < 6; ++i) {
    const Eigen::Vector3d corner = point();
    const Box box{corner, corner + Eigen::Vector3d(0.2 + uniform(engine), 0.2 + uniform(engine),
                                                   0.2 + uniform(engine))};
    (i < 4 ? setting.furniture : setting.people).push_back(box);
  }
  do {
    setting.origin = point();
  } while (std::any_of(setting.furniture.begin(), setting.furniture.end(),
                       [&](const Box& box) { return Inside(box, setting.origin); }) ||
           std::any_of(setting.people.begin(), setting.people.end(),
                       [&](const Box& box) { return Inside(box, setting.origin); }));
  setting.direction = (point() - setting.origin).normalized();
  return setting;
}

// Walks along the ray in steps of half a millimetre.
double MarchedRange(const Setting& setting) {
  constexpr double kStepM = 0.0005;
  for (double range_m = 0.0;; range_m += kStepM) {
    const Eigen::Vector3d point = setting.origin + range_m * setting.direction;
    if (!Inside({Eigen::Vector3d::Zero(), kRoom}, point)) return range_m;
    for (const auto* boxes : {&setting.furniture, &setting.people}) {
      for (const Box& box : *boxes) {
        if (Inside(box, point)) return range_m;
      }
    }
  }
}

TEST(RayCaster, RangesAgreeWithMarchingAlongTheRay) {
  std::mt19937 engine(7);
  int at_boxes = 0;
  for (int i = 0; i < 500; ++i) {
    const Setting setting = RandomSetting(engine);
    const RayCaster rays(kRoom, setting.furniture);
    const double range_m = rays.RangeM(setting.origin, setting.direction, setting.people);
    EXPECT_NEAR(range_m, MarchedRange(setting), 0.002);
    at_boxes += range_m < RayCaster(kRoom, {}).RangeM(setting.origin, setting.direction) - 1e-9;
  }
  EXPECT_GT(at_boxes, 50);
}

TEST(RayCaster, RaysAlongTheAxesMeetTheWalls) {
  const RayCaster rays(kRoom, {});
  const Eigen::Vector3d origin(1.0, 2.0, 0.5);
  EXPECT_DOUBLE_EQ(rays.RangeM(origin, Eigen::Vector3d::UnitX()), 5.0);
  EXPECT_DOUBLE_EQ(rays.RangeM(origin, -Eigen::Vector3d::UnitX()), 1.0);
  EXPECT_DOUBLE_EQ(rays.RangeM(origin, Eigen::Vector3d::UnitZ()), 2.0);
}

TEST(RayCaster, ABoxBetweenTwoPointsBlocksAndOneThatIsTouchedDoesNot) {
  const RayCaster rays(kRoom, {{{2, 2, 0}, {3, 3, 1}}});
  EXPECT_TRUE(rays.IsBlocked({1, 2.5, 0.5}, {4, 2.5, 0.5}));
  EXPECT_FALSE(rays.IsBlocked({1, 2.5, 1.5}, {4, 2.5, 1.5}));
  EXPECT_FALSE(rays.IsBlocked({1, 2.5, 0.5}, {1.9, 2.5, 0.5}));
  EXPECT_FALSE(rays.IsBlocked({2.5, 2.5, 1.0}, {4, 2.5, 2}));  // a source on top of it
  EXPECT_TRUE(
      rays.IsBlocked({1, 4, 0.5}, {1, 1, 0.5}, std::vector<Box>{{{0.5, 2, 0}, {1.5, 2.5, 2}}}));
}

}  // namespace
}  // namespace soundmap::simulation
