#include "sound_map/views.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace soundmap::sound_map {
namespace {

constexpr double kSpacing_m = 1.0;

// Robots on random walks, against their scans written down and cut into views afterwards.
TEST(Views, AreThoseOfTheRobotsWaysCutByTheMetre) {
  struct Scan {
    Eigen::Vector2d robot_in_map_m;
    bool at_maximum;
  };
  std::mt19937 random(3);
  std::normal_distribution<double> step_m(0.0, 0.15);
  for (int trial = 0; trial < 50; ++trial) {
    Views views;
    std::map<std::string, std::vector<Scan>> ways;
    for (int i = 0; i < 150; ++i) {
      const std::string robot = std::to_string(random() % 3);
      std::vector<Scan>& way = ways[robot];
      Scan scan{Eigen::Vector2d(step_m(random), step_m(random)), random() % 12 == 0};
      if (!way.empty()) scan.robot_in_map_m += way.back().robot_in_map_m;
      way.push_back(scan);
      views.Add(robot, scan.robot_in_map_m, scan.at_maximum, kSpacing_m);
    }
    int count = 0;
    int heard = 0;
    for (const auto& [robot, way] : ways) {
      for (std::size_t begin = 0, end = 0; begin < way.size(); begin = end) {
        int with_maximum = 0;
        for (; end < way.size(); ++end) {
          const Eigen::Vector2d moved_m = way[end].robot_in_map_m - way[begin].robot_in_map_m;
          if (std::hypot(moved_m.x(), moved_m.y()) >= kSpacing_m) break;
          with_maximum += way[end].at_maximum;
        }
        ++count;
        heard += with_maximum > 0 && 10 * with_maximum >= static_cast<int>(end - begin);
      }
    }
    ASSERT_LT(count, 32);  // none is forgotten yet
    EXPECT_EQ(views.count(), count);
    EXPECT_EQ(views.heard(), heard);
  }
}

TEST(Views, ATenthOfTheScansHearsThePlace) {
  const auto heard = [](int scans, int with_maximum) {
    Views views;
    for (int i = 0; i < scans; ++i) {
      views.Add("r1", Eigen::Vector2d::Zero(), i < with_maximum, kSpacing_m);
    }
    EXPECT_EQ(views.count(), 1.0);
    return views.heard();
  };
  EXPECT_EQ(heard(1, 0), 0.0);
  EXPECT_EQ(heard(1, 1), 1.0);
  EXPECT_EQ(heard(10, 1), 1.0);
  EXPECT_EQ(heard(11, 1), 0.0);
  EXPECT_EQ(heard(1000, 100), 1.0);
  EXPECT_EQ(heard(1000, 99), 0.0);
}

// They count for less with time, those that heard the place and those that did not alike.
TEST(Views, OldOnesAreForgottenAndTheShareStays) {
  Views views;
  for (int view = 0; view < 4000; ++view) {
    views.Add("r1", Eigen::Vector2d(2.0 * view, 0.0), view % 4 == 0, kSpacing_m);
    EXPECT_LE(views.count(), 34.0);
    EXPECT_NEAR(views.kept_share(), views.count() / (view + 1.0), 1e-12);
    if (view > 100) {
      EXPECT_NEAR(views.heard() / views.count(), 0.25, 0.05);
    }
  }
}

// However many robots there are, each scan's view counts, and the memory is bounded.
TEST(Views, ManyRobotsAreBounded) {
  Views views;
  for (int robot = 0; robot < 1000; ++robot) {
    views.Add(std::to_string(robot), Eigen::Vector2d::Zero(), true, kSpacing_m);
    if (robot < 30) {
      EXPECT_EQ(views.count(), robot + 1.0);
    }
    EXPECT_EQ(views.heard(), views.count());
  }
  EXPECT_LE(views.present.size(), 64u);
  EXPECT_LE(views.count(), 128.0);
}

TEST(Views, TheOddsAreThoseOfTheRegression) {
  Views views;
  views.past = 6.0;
  views.past_heard = 2.5;
  views.ended = 14.0;
  views.Add("r1", Eigen::Vector2d::Zero(), true, kSpacing_m);
  views.Add("r2", Eigen::Vector2d::Zero(), false, kSpacing_m);
  const auto odds = [](double evidence, double h) {
    return std::exp(-6.82) * std::pow(evidence, 1.37) * std::pow(h + 1.0, 1.28);
  };
  // 8 of 16 views are kept.
  EXPECT_NEAR(std::exp(LogOddsByViews(150.0, views, {}, {})), odds(75.0, 3.5), 1e-9);
  EXPECT_NEAR(std::exp(LogOddsByViews(1e6, views, {}, {})), odds(200.0, 3.5), 1e-9);
  EXPECT_NEAR(std::exp(LogOddsByViews(150.0, views, {0.5, 0.25}, {})),
              odds(75.0, 3.5) * std::exp(-5.48 * 0.5 - 2.02 * 0.25), 1e-9);
  const auto in_plane = [](double evidence, double h, double d, double echo) {
    return std::exp(-7.55 - 3.01 * d + 0.36 * echo) * std::pow(evidence, 1.26) *
           std::pow(h + 1.0, 0.8);
  };
  EXPECT_NEAR(std::exp(LogOddsByViews(150.0, views, {}, 0.0)), in_plane(75.0, 3.5, 0.0, 0.0), 1e-9);
  EXPECT_NEAR(std::exp(LogOddsByViews(150.0, views, {0.5, 0.25}, 2.5)),
              in_plane(75.0, 3.5, 0.5, 2.5), 1e-9);
  EXPECT_NEAR(std::exp(LogOddsByViews(1e6, views, {}, 50.0)), in_plane(200.0, 3.5, 0.0, 8.0), 1e-6);
  EXPECT_NEAR(std::exp(LogOddsByViews(150.0, views, {}, -50.0)), in_plane(75.0, 3.5, 0.0, -3.0),
              1e-9);
}

}  // namespace
}  // namespace soundmap::sound_map
