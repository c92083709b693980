#include "cli/visibility.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

namespace soundmap::cli {
namespace {

constexpr std::int64_t kS = 1'000'000'000;

SceneTruth Room() {
  SceneTruth scene;
  scene.room_size_m = Vector3{10, 7, 2.7};
  scene.obstacles = {{{4, 0, 0}, {5, 3, 2.0}}};  // a cabinet
  return scene;
}

TEST(IsUnobstructed, TheCeilingItselfIsVisible) {
  EXPECT_TRUE(IsUnobstructed({1, 1, 1}, {8, 6, 2.7}, Room()));
  EXPECT_TRUE(IsUnobstructed({1, 1, 1}, {0, 3, 1}, Room()));
  EXPECT_FALSE(IsUnobstructed({1, 1, 1}, {8, 6, 3.0}, Room()));   // above the ceiling
  EXPECT_FALSE(IsUnobstructed({1, 1, 1}, {-0.5, 1, 1}, Room()));  // behind a wall
}

TEST(IsUnobstructed, AnObstacleHidesWhatIsBehindIt) {
  EXPECT_FALSE(IsUnobstructed({1, 1, 1}, {8, 1, 1}, Room()));
  EXPECT_TRUE(IsUnobstructed({1, 1, 1}, {3, 1, 1}, Room()));      // in front
  EXPECT_TRUE(IsUnobstructed({1, 5, 1}, {8, 5, 1}, Room()));      // past it
  EXPECT_TRUE(IsUnobstructed({3, 1, 2.5}, {6, 1, 2.5}, Room()));  // over it
}

TEST(IsUnobstructed, ASourceOnAnObstacleIsSeenFromItsSide) {
  EXPECT_TRUE(IsUnobstructed({1, 1, 1}, {4, 1, 1}, Room()));
  EXPECT_FALSE(IsUnobstructed({8, 1, 1}, {4, 1, 1}, Room()));
  EXPECT_TRUE(IsUnobstructed({1, 1, 2.5}, {4.5, 1, 2.0}, Room()));  // on top, from above
  EXPECT_FALSE(IsUnobstructed({1, 1, 1}, {4.9, 1, 2.0}, Room()));   // on top, from below
}

TEST(IsUnobstructed, AHousingDoesNotHideItsSource) {
  EXPECT_TRUE(IsUnobstructed({1, 1, 1}, {4.5, 1.5, 1}, Room()));
}

TEST(IsUnobstructed, AThinPanelHides) {
  SceneTruth scene;
  scene.obstacles = {{{4, 0, 0}, {4.01, 3, 2}}};
  EXPECT_FALSE(IsUnobstructed({1, 1, 1}, {8, 1, 1}, scene));
  EXPECT_TRUE(IsUnobstructed({1, 4, 1}, {8, 4, 1}, scene));
}

// Brute force: does any of 20 000 points of the line lie inside an obstacle, 2 cm or more below its
// surface?
TEST(IsUnobstructed, AgreesWithPointsAlongTheLine) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> uniform(0.0, 5.0);
  const auto point = [&] { return Vector3{uniform(random), uniform(random), uniform(random)}; };
  int hidden_count = 0;
  for (int run = 0; run < 300; ++run) {
    SceneTruth scene;
    const Vector3 a = point(), b = point();
    scene.obstacles = {{{std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)},
                        {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)}}};
    const Box& box = scene.obstacles[0];
    if (box.max_m.x - box.min_m.x < 0.2 || box.max_m.y - box.min_m.y < 0.2 ||
        box.max_m.z - box.min_m.z < 0.2) {
      continue;
    }
    const auto depth = [&box](const Vector3& p) {
      return std::min({p.x - box.min_m.x, box.max_m.x - p.x, p.y - box.min_m.y, box.max_m.y - p.y,
                       p.z - box.min_m.z, box.max_m.z - p.z});
    };
    const Vector3 from = point(), to = point();
    double deepest = -1.0;
    for (int i = 0; i <= 20000; ++i) {
      const double s = i / 20000.0;
      deepest = std::max(deepest, depth({from.x + s * (to.x - from.x), from.y + s * (to.y - from.y),
                                         from.z + s * (to.z - from.z)}));
    }
    if (std::abs(deepest - 0.02) < 1e-3) continue;  // too close for the sampling to tell
    const bool hidden = deepest > 0.02 && depth(to) < 0.02;
    hidden_count += hidden;
    EXPECT_EQ(IsUnobstructed(from, to, scene), !hidden) << run;
  }
  EXPECT_GT(hidden_count, 20);
}

TEST(ArrayPath, TurnsTheMountingWithTheRobot) {
  const auto path = ArrayPath({{5, {1.0, 2.0, std::numbers::pi / 2}}}, Vector3{0.3, 0.1, 1.2});
  ASSERT_EQ(path.size(), 1u);
  EXPECT_EQ(path[0].time_ns, 5);
  EXPECT_NEAR(path[0].in_map_m.x, 0.9, 1e-12);
  EXPECT_NEAR(path[0].in_map_m.y, 2.3, 1e-12);
  EXPECT_NEAR(path[0].in_map_m.z, 1.2, 1e-12);
}

// A drive along x at `speed_mps`, ten poses a second from t = 100 s.
std::vector<ArrayPosition> Drive(double duration_s, double speed_mps) {
  std::vector<ArrayPosition> path;
  for (int i = 0; i <= std::lround(duration_s * 10); ++i) {
    path.push_back({100 * kS + i * kS / 10, {1.0 + speed_mps * i / 10.0, 5.0, 1.0}});
  }
  return path;
}

bool SeenIn(const std::vector<ArrayPosition>& path, TrueSource source, double max_range_m = 20.0) {
  SceneTruth scene = Room();
  source.position_in_map_m = {1.0, 6.0, 2.7};
  scene.sources = {source};
  return SourcesInView(scene, path, 100 * kS, max_range_m).at(0);
}

TEST(SourcesInView, NeedsFiveSeconds) {
  EXPECT_TRUE(SeenIn(Drive(5.0, 0.3), {}));
  EXPECT_FALSE(SeenIn(Drive(4.9, 0.3), {}));
}

TEST(SourcesInView, NeedsTwoPosesOneMetreApart) {
  EXPECT_FALSE(SeenIn(Drive(60.0, 0.0), {}));
  EXPECT_FALSE(SeenIn(Drive(9.9, 0.1), {}));
  EXPECT_TRUE(SeenIn(Drive(10.0, 0.1), {}));
}

TEST(SourcesInView, CountsOnlyWhileOn) {
  EXPECT_TRUE(SeenIn(Drive(20.0, 0.3), {.on_s = 10.0, .off_s = 15.0}));
  EXPECT_FALSE(SeenIn(Drive(20.0, 0.3), {.on_s = 10.0, .off_s = 14.9}));
  EXPECT_FALSE(SeenIn(Drive(20.0, 0.3), {.on_s = 15.1}));
  EXPECT_FALSE(SeenIn(Drive(20.0, 0.3), {.off_s = 4.9}));
}

TEST(SourcesInView, CountsOnlyWithinRange) {
  // At x = 1 + d the source is sqrt(d^2 + 1 + 1.7^2) away: 2.2 m at d = 0.975, reached after 3.25
  // s.
  EXPECT_FALSE(SeenIn(Drive(20.0, 0.3), {}, 2.2));
  // 2.5 m at d = 1.536, reached after 5.1 s.
  EXPECT_TRUE(SeenIn(Drive(20.0, 0.3), {}, 2.5));
}

TEST(SourcesInView, AGapIsNoTimeInView) {
  std::vector<ArrayPosition> path = Drive(4.0, 0.3);
  for (ArrayPosition position : Drive(0.5, 0.3)) {
    position.time_ns += 10 * kS;
    path.push_back(position);
  }
  EXPECT_FALSE(SeenIn(path, {}));
}

TEST(SourcesInView, SumsSeparateViews) {
  // Behind the cabinet's corner the source is hidden in the middle of the drive.
  SceneTruth scene = Room();
  scene.sources = {{.position_in_map_m = {4.5, 6.9, 1.0}}};
  scene.obstacles = {{{4, 6, 0}, {5, 6.5, 2.0}}};
  const auto path = Drive(20.0, 0.4);  // x = 1 .. 9 at y = 5
  EXPECT_TRUE(SourcesInView(scene, path, 100 * kS, 20.0).at(0));
  scene.obstacles = {{{0.5, 6, 0}, {9.5, 6.5, 2.0}}};
  EXPECT_FALSE(SourcesInView(scene, path, 100 * kS, 20.0).at(0));
}

TEST(SourcesInView, NothingIsInViewOfNoPath) { EXPECT_FALSE(SeenIn({}, {})); }

}  // namespace
}  // namespace soundmap::cli
