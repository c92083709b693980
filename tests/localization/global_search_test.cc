#include "localization/global_search.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "geometry/angles.h"
#include "synthetic_room.h"

namespace soundmap::localization {
namespace {

using geometry::Pose2;

std::vector<Eigen::Vector2d> EndsAt(const SyntheticRoom& room, const Pose2& pose, int count) {
  std::vector<Eigen::Vector2d> ends;
  for (int i = 0; i < count; ++i) {
    const double angle_rad = (1.5 * i / count - 0.75) * geometry::kPi;
    const double range_m = room.Range(pose.x_m, pose.y_m, pose.yaw_rad + angle_rad);
    ends.emplace_back(range_m * std::cos(angle_rad), range_m * std::sin(angle_rad));
  }
  return ends;
}

// The score by its definition: the distance to the nearest occupied cell, by looking at all of
// them.
double Score(const building::FloorPlan& plan, const std::vector<Eigen::Vector2d>& ends,
             const Pose2& pose, double field_std_m) {
  double sum = 0.0;
  for (const Eigen::Vector2d& end : ends) {
    const Pose2 at = pose * Pose2{end.x(), end.y(), 0.0};
    double nearest_m = 1e9;
    for (int row = 0; row < plan.height(); ++row) {
      for (int column = 0; column < plan.width(); ++column) {
        if (plan.at(column, row) != building::Cell::kOccupied) continue;
        const Eigen::Vector2d centre =
            plan.origin_in_map_m() + plan.cell_size_m() * Eigen::Vector2d(column + 0.5, row + 0.5);
        nearest_m = std::min(nearest_m, std::hypot(centre.x() - at.x_m, centre.y() - at.y_m));
      }
    }
    sum += std::exp(-0.5 * nearest_m * nearest_m / (field_std_m * field_std_m));
  }
  return sum / static_cast<double>(ends.size());
}

int SectorOf(double yaw_rad, int sectors) {
  const double turn = (yaw_rad < 0.0 ? yaw_rad + 2.0 * geometry::kPi : yaw_rad);
  return static_cast<int>(turn / (2.0 * geometry::kPi) * sectors);
}

TEST(GlobalSearch, FindsThePlaceThatTheScanWasTakenAt) {
  const SyntheticRoom floor = OfficeFloor();
  const SearchConfig config;
  const GlobalSearch search(config, floor.Plan());
  const Pose2 places[] = {{12.0, 7.0, 2.9}, {36.0, 12.4, -2.0}, {4.0, 4.0, 0.4}, {22.0, 4.0, 1.3}};
  for (const Pose2& place : places) {
    const auto found =
        search.Search(EndsAt(floor, place, 120), SectorOf(place.yaw_rad, config.sectors));
    // A score near that of another place: rectangular rooms look alike by the ends of beams alone.
    ASSERT_FALSE(found.empty());
    double nearest_m = 1e9;
    for (const Candidate& candidate : found) {
      EXPECT_EQ(SectorOf(candidate.map_from_base.yaw_rad, config.sectors),
                SectorOf(place.yaw_rad, config.sectors));
      if (std::abs(geometry::NormalizeAngle(candidate.map_from_base.yaw_rad - place.yaw_rad)) >
              geometry::RadFromDeg(3.0) ||
          candidate.score < 0.8) {
        continue;
      }
      nearest_m = std::min(nearest_m, std::hypot(candidate.map_from_base.x_m - place.x_m,
                                                 candidate.map_from_base.y_m - place.y_m));
    }
    EXPECT_LT(nearest_m, 0.2);
  }
}

// Branch and bound must return what trying each cell and each yaw returns.
TEST(GlobalSearch, NoOtherPoseIsBetter) {
  const SyntheticRoom room{{0.0, 0.0, 4.0, 3.0}, {{2.4, 0.0, 2.8, 1.2}, {0.0, 2.0, 0.8, 3.0}}};
  const building::FloorPlan plan = room.Plan(0.1);
  SearchConfig config;
  config.cell_m = 0.1;
  config.sectors = 24;
  config.yaw_step_rad = geometry::RadFromDeg(5.0);
  config.max_evaluations = 1'000'000;
  const GlobalSearch search(config, plan);
  const auto ends = EndsAt(room, {1.3, 1.1, 0.6}, 12);
  for (int sector = 0; sector < config.sectors; sector += 4) {
    double best = 0.0;
    for (int yaw = 0; yaw < 3; ++yaw) {
      const double yaw_rad = (sector + (yaw + 0.5) / 3.0) * 2.0 * geometry::kPi / 24.0;
      for (int row = 0; row < plan.height(); ++row) {
        for (int column = 0; column < plan.width(); ++column) {
          if (plan.at(column, row) != building::Cell::kFree) continue;
          const Eigen::Vector2d at =
              plan.origin_in_map_m() + 0.1 * Eigen::Vector2d(column + 0.5, row + 0.5);
          best = std::max(best, Score(plan, ends, {at.x(), at.y(), yaw_rad}, config.field_std_m));
        }
      }
    }
    const auto found = search.Search(ends, sector);
    // The search rounds the ends to cells: half a cell along each axis.
    if (best > config.min_score + 0.15) {
      ASSERT_FALSE(found.empty()) << sector;
    }
    if (!found.empty()) {
      EXPECT_NEAR(found[0].score, best, 0.15) << sector;
    }
    for (std::size_t i = 1; i < found.size(); ++i) {
      EXPECT_LE(found[i].score, found[i - 1].score);
      for (std::size_t j = 0; j < i; ++j) {
        const Pose2 between = found[j].map_from_base.Inverse() * found[i].map_from_base;
        EXPECT_TRUE(std::hypot(between.x_m, between.y_m) >= config.apart_m - 1e-6 ||
                    std::abs(between.yaw_rad) >= config.apart_rad - 1e-6);
      }
    }
  }
}

TEST(GlobalSearch, StandsOnlyWhereThePlanIsFree) {
  const SyntheticRoom floor = OfficeFloor();
  const building::FloorPlan plan = floor.Plan();
  SearchConfig config;
  config.min_score = 0.1;
  const GlobalSearch search(config, plan);
  int candidates = 0;
  for (int sector = 0; sector < config.sectors; ++sector) {
    for (const Candidate& candidate : search.Search(EndsAt(floor, {12.0, 7.0, 2.9}, 120), sector)) {
      const Eigen::Vector2d cell =
          (Eigen::Vector2d(candidate.map_from_base.x_m, candidate.map_from_base.y_m) -
           plan.origin_in_map_m()) /
          plan.cell_size_m();
      bool free = false;
      for (int v = -1; v <= 1; ++v) {
        for (int u = -1; u <= 1; ++u) {
          const int column = static_cast<int>(cell.x()) + u;
          const int row = static_cast<int>(cell.y()) + v;
          free =
              free || (plan.Contains(column, row) && plan.at(column, row) == building::Cell::kFree);
        }
      }
      EXPECT_TRUE(free);
      ++candidates;
    }
  }
  EXPECT_GT(candidates, 50);
}

TEST(GlobalSearch, NothingToSearchWithOrInGivesNothing) {
  const SyntheticRoom room;
  const GlobalSearch search(SearchConfig(), room.Plan());
  EXPECT_TRUE(search.has_free_cell());
  EXPECT_TRUE(search.Search({}, 0).empty());
  const std::vector<Eigen::Vector2d> far(30, Eigen::Vector2d(500.0, 0.0));
  EXPECT_TRUE(search.Search(far, 0).empty());
  building::FloorPlan solid(50, 50, 0.05, {0.0, 0.0});
  for (int row = 0; row < 50; ++row) {
    for (int column = 0; column < 50; ++column) solid.at(column, row) = building::Cell::kOccupied;
  }
  const GlobalSearch nowhere(SearchConfig(), solid);
  EXPECT_FALSE(nowhere.has_free_cell());
  EXPECT_TRUE(nowhere.Search(EndsAt(room, {1.0, 1.0, 0.0}, 50), 0).empty());
}

// A square kilometre is searched on coarser cells, with the memory of a few million.
TEST(GlobalSearch, ALargePlanIsSearchedCoarsely) {
  building::FloorPlan plan(5000, 5000, 0.2, {-500.0, -500.0});
  for (int row = 0; row < 5000; ++row) {
    for (int column = 0; column < 5000; ++column) {
      // A hall of 60 x 30 m in the middle of free space.
      const bool wall = column >= 2400 && column <= 2700 && row >= 2400 && row <= 2550 &&
                        (column == 2400 || column == 2700 || row == 2400 || row == 2550);
      plan.at(column, row) = wall ? building::Cell::kOccupied : building::Cell::kFree;
    }
  }
  const GlobalSearch search(SearchConfig(), plan);
  EXPECT_GT(search.tolerance_m(), 0.4);
  EXPECT_LT(search.tolerance_m(), 0.6);
}

}  // namespace
}  // namespace soundmap::localization
