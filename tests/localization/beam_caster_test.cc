#include "localization/beam_caster.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <random>

#include "geometry/angles.h"
#include "synthetic_room.h"

namespace soundmap::localization {
namespace {

using building::Cell;
using building::FloorPlan;

// By definition: unknown, and in a square of unknown cells; all outside the plan is unknown.
bool IsWideUnknown(const FloorPlan& plan, int column, int row, int side) {
  const auto unknown = [&](int x, int y) {
    return !plan.Contains(x, y) || plan.at(x, y) == Cell::kUnknown;
  };
  for (int y0 = row - side + 1; y0 <= row; ++y0) {
    for (int x0 = column - side + 1; x0 <= column; ++x0) {
      bool all = true;
      for (int y = y0; y < y0 + side && all; ++y) {
        for (int x = x0; x < x0 + side && all; ++x) all = unknown(x, y);
      }
      if (all) return true;
    }
  }
  return false;
}

// Exact traversal in double precision, from edge to edge of the cells (Amanatides and Woo).
Return Traverse(const FloorPlan& plan, int gap_cells, double x_m, double y_m, double dx,
                double dy) {
  const double x = (x_m - plan.origin_in_map_m().x()) / plan.cell_size_m();
  const double y = (y_m - plan.origin_in_map_m().y()) / plan.cell_size_m();
  int column = static_cast<int>(std::floor(x));
  int row = static_cast<int>(std::floor(y));
  const double infinity = std::numeric_limits<double>::infinity();
  double next_x = dx > 0 ? (column + 1 - x) / dx : dx < 0 ? (column - x) / dx : infinity;
  double next_y = dy > 0 ? (row + 1 - y) / dy : dy < 0 ? (row - y) / dy : infinity;
  double travelled = 0.0;
  while (true) {
    const auto range_m = static_cast<float>(travelled * plan.cell_size_m());
    if (!plan.Contains(column, row)) return {range_m, Ending::kUnknown};
    if (plan.at(column, row) == Cell::kOccupied) return {range_m, Ending::kWall};
    if (plan.at(column, row) == Cell::kUnknown && IsWideUnknown(plan, column, row, gap_cells)) {
      return {range_m, Ending::kUnknown};
    }
    if (next_x < next_y) {
      travelled = next_x;
      next_x += 1.0 / std::abs(dx);
      column += dx > 0 ? 1 : -1;
    } else {
      travelled = next_y;
      next_y += 1.0 / std::abs(dy);
      row += dy > 0 ? 1 : -1;
    }
  }
}

Return CastOne(const BeamCaster& caster, const Ray& ray) {
  Return result{};
  caster.Cast({&ray, 1}, {&result, 1});
  return result;
}

FloorPlan RandomPlan(std::mt19937_64& engine) {
  std::uniform_int_distribution<int> side(1, 120);
  FloorPlan plan(side(engine), side(engine), 0.05, {-3.7, 1.234});
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  const double occupied = 0.02 * uniform(engine);
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      const double draw = uniform(engine);
      plan.at(column, row) = draw < occupied          ? Cell::kOccupied
                             : draw < occupied + 0.05 ? Cell::kUnknown
                                                      : Cell::kFree;
    }
  }
  // A wide patch of the unknown.
  std::uniform_int_distribution<int> left(0, plan.width() - 1);
  std::uniform_int_distribution<int> low(0, plan.height() - 1);
  const int x0 = left(engine);
  const int y0 = low(engine);
  for (int row = y0; row < std::min(plan.height(), y0 + 8); ++row) {
    for (int column = x0; column < std::min(plan.width(), x0 + 5); ++column) {
      plan.at(column, row) = Cell::kUnknown;
    }
  }
  plan.at(left(engine), low(engine)) = Cell::kOccupied;
  return plan;
}

TEST(BeamCaster, FindsTheCellOfAnExactTraversal) {
  std::mt19937_64 engine(7);
  int compared = 0;
  int grazing = 0;
  for (int round = 0; round < 60; ++round) {
    const FloorPlan plan = RandomPlan(engine);
    const auto caster = BeamCaster::Create(plan, /*unknown_gap_m=*/0.2);
    ASSERT_TRUE(caster.ok()) << caster.status();
    std::uniform_real_distribution<double> x(0.0, plan.width() * 0.05);
    std::uniform_real_distribution<double> y(0.0, plan.height() * 0.05);
    std::uniform_real_distribution<double> angle(-geometry::kPi, geometry::kPi);
    std::vector<Ray> rays;
    for (int i = 0; i < 333; ++i) {
      const double a = i % 10 == 0 ? geometry::kPi / 4.0 * (i / 10 % 8) : angle(engine);
      rays.push_back({static_cast<float>(plan.origin_in_map_m().x() + x(engine)),
                      static_cast<float>(plan.origin_in_map_m().y() + y(engine)),
                      static_cast<float>(std::cos(a)), static_cast<float>(std::sin(a))});
    }
    std::vector<Return> returns(rays.size());
    caster->Cast(rays, returns);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const Ray& ray = rays[i];
      const Return exact = Traverse(plan, 4, ray.x_m, ray.y_m, ray.direction_x, ray.direction_y);
      ++compared;
      if (std::abs(returns[i].range_m - exact.range_m) < 1e-3 &&
          returns[i].ending == exact.ending) {
        continue;
      }
      // A ray that touches a corner may pass it on either side: one of its neighbours within 1 mm
      // and 0.03 degrees must agree.
      ++grazing;
      bool agrees = false;
      for (int v = -1; v <= 1; ++v) {
        for (int u = -1; u <= 1; ++u) {
          for (int w = -1; w <= 1; ++w) {
            const double a = std::atan2(ray.direction_y, ray.direction_x) + w * 5e-4;
            const Return near =
                Traverse(plan, 4, ray.x_m + u * 1e-3, ray.y_m + v * 1e-3, std::cos(a), std::sin(a));
            agrees |= std::abs(returns[i].range_m - near.range_m) < 0.02 &&
                      returns[i].ending == near.ending;
          }
        }
      }
      EXPECT_TRUE(agrees) << "round " << round << " ray " << i << ": " << returns[i].range_m
                          << " against " << exact.range_m;
    }
  }
  EXPECT_LT(grazing, compared / 200);
}

TEST(BeamCaster, AgreesWithTheRoomsGeometry) {
  const SyntheticRoom room;
  const auto caster = BeamCaster::Create(room.Plan(), 0.3).value();
  for (int i = 0; i < 720; ++i) {
    const double angle_rad = (i + 0.5) * geometry::kPi / 360.0;
    const Return result = CastOne(caster, {2.013f, 1.507f, static_cast<float>(std::cos(angle_rad)),
                                           static_cast<float>(std::sin(angle_rad))});
    EXPECT_EQ(result.ending, Ending::kWall);
    EXPECT_NEAR(result.range_m, room.Range(2.013, 1.507, angle_rad), 2e-3) << angle_rad;
  }
}

TEST(BeamCaster, NarrowUnknownIsTransparentAndWideUnknownEndsTheBeam) {
  FloorPlan plan(40, 20, 0.1, {0.0, 0.0});
  for (int row = 0; row < 20; ++row) {
    for (int column = 0; column < 40; ++column) plan.at(column, row) = Cell::kFree;
    plan.at(10, row) = Cell::kUnknown;
    plan.at(11, row) = Cell::kUnknown;
    plan.at(39, row) = Cell::kOccupied;
  }
  const Ray along_x{0.05f, 1.05f, 1.0f, 0.0f};
  const Return through = CastOne(BeamCaster::Create(plan, 0.3).value(), along_x);
  EXPECT_EQ(through.ending, Ending::kWall);
  EXPECT_NEAR(through.range_m, 3.85, 1e-4);
  const Return stopped = CastOne(BeamCaster::Create(plan, 0.2).value(), along_x);
  EXPECT_EQ(stopped.ending, Ending::kUnknown);
  EXPECT_NEAR(stopped.range_m, 0.95, 1e-4);
  // Past the edge of the plan nothing is known.
  const Return out = CastOne(BeamCaster::Create(plan, 0.3).value(), {2.05f, 1.05f, 0.0f, -1.0f});
  EXPECT_EQ(out.ending, Ending::kUnknown);
  EXPECT_NEAR(out.range_m, 1.05, 1e-4);
}

TEST(BeamCaster, EndsForAnyNumbers) {
  const auto caster = BeamCaster::Create(SyntheticRoom().Plan(), 0.3).value();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  const float numbers[] = {0.0f,    -0.0f, 1.0f, -1.0f,    4.0f,     1e-38f,
                           -1e-30f, 1e30f, nan,  infinity, -infinity};
  for (const float x : numbers) {
    for (const float y : numbers) {
      for (const float dx : numbers) {
        for (const float dy : numbers) {
          const Return result = CastOne(caster, {x, y, dx, dy});
          EXPECT_GE(result.range_m, 0.0f);
          EXPECT_LT(result.range_m, 20.0f);
        }
      }
    }
  }
  EXPECT_EQ(CastOne(caster, {-50.0f, 1.0f, 1.0f, 0.0f}).ending, Ending::kUnknown);
  EXPECT_EQ(CastOne(caster, {nan, 1.0f, 1.0f, 0.0f}).ending, Ending::kUnknown);
}

TEST(BeamCaster, RefusesPlansThatItCannotTrace) {
  FloorPlan free(3, 3, 0.05, {0.0, 0.0});
  EXPECT_THAT(std::string(BeamCaster::Create(free, 0.3).status().message()),
              testing::HasSubstr("no occupied cell"));
  EXPECT_FALSE(BeamCaster::Create(FloorPlan(), 0.3).ok());
  EXPECT_FALSE(BeamCaster::Create(FloorPlan(40000, 1, 0.05, {0.0, 0.0}), 0.3).ok());
  EXPECT_FALSE(BeamCaster::Create(FloorPlan(2, 2, std::nan(""), {0.0, 0.0}), 0.3).ok());
}

}  // namespace
}  // namespace soundmap::localization
