#include "localization/scan_matcher.h"

#include <gtest/gtest.h>

#include <cmath>

#include "geometry/angles.h"
#include "synthetic_room.h"

namespace soundmap::localization {
namespace {

using building::Cell;
using building::FloorPlan;
using geometry::Pose2;

std::vector<Beam> BeamsAt(const SyntheticRoom& room, const Pose2& pose) {
  std::vector<Beam> beams;
  for (int i = 0; i < 360; ++i) {
    const double angle_rad = i * geometry::kPi / 180.0;
    beams.push_back({{0.0, 0.0},
                     {std::cos(angle_rad), std::sin(angle_rad)},
                     room.Range(pose.x_m, pose.y_m, pose.yaw_rad + angle_rad)});
  }
  return beams;
}

ScanMatcher MakeMatcher(const FloorPlan& plan) {
  return ScanMatcher({}, plan, BeamCaster::Create(plan, 0.3).value());
}

Distribution Prior(const Pose2& mean) {
  Distribution prior{mean, Eigen::Matrix3d::Zero()};
  prior.covariance.diagonal() << 0.0025, 0.0025, 0.0004;
  return prior;
}

TEST(ScanMatcher, FindsAPoseBetweenTheCells) {
  const SyntheticRoom room;
  const ScanMatcher matcher = MakeMatcher(room.Plan());
  for (const Pose2 truth :
       {Pose2{1.513, 1.471, 0.3}, Pose2{6.537, 4.722, -2.9}, Pose2{2.219, 3.003, 1.234}}) {
    const auto match = matcher.Match(
        BeamsAt(room, truth), Prior({truth.x_m + 0.05, truth.y_m - 0.06, truth.yaw_rad + 0.03}));
    ASSERT_TRUE(match.has_value());
    EXPECT_NEAR(match->mean.x_m, truth.x_m, 0.003);
    EXPECT_NEAR(match->mean.y_m, truth.y_m, 0.003);
    EXPECT_NEAR(geometry::NormalizeAngle(match->mean.yaw_rad - truth.yaw_rad), 0.0, 0.002);
    EXPECT_LT(std::sqrt(match->covariance(0, 0)), 0.02);
  }
}

// A LIDAR's wall: where it lies on the edge of two rows of cells both are occupied here and there,
// unknown is behind.
TEST(ScanMatcher, AWallOfTwoNoisyLayersLiesBetweenThem) {
  FloorPlan plan(200, 200, 0.05, {-5.0, -5.0});
  for (int row = 0; row < 200; ++row) {
    for (int column = 0; column < 200; ++column) {
      const double x_m = -5.0 + (column + 0.5) * 0.05;
      const double y_m = -5.0 + (row + 0.5) * 0.05;
      const double to_wall_m = 3.0 - std::max(std::abs(x_m), std::abs(y_m));
      const bool gap = (row * 7 + column * 13) % 5 == 0;
      if (to_wall_m > 0.0) plan.at(column, row) = Cell::kFree;
      if (std::abs(to_wall_m) < 0.05) {
        plan.at(column, row) =
            gap ? (to_wall_m > 0.0 ? Cell::kFree : Cell::kUnknown) : Cell::kOccupied;
      }
    }
  }
  // The room is larger to one side of the robot: a shared shift of all walls would not cancel in x
  // and y alone.
  const SyntheticRoom room{{-3.0, -3.0, 3.0, 3.0}, {}};
  const Pose2 truth{1.3, -0.8, 0.5};
  auto beams = BeamsAt(room, truth);
  // Only two walls, to the east and the south.
  std::erase_if(beams, [&](const Beam& beam) {
    const Eigen::Vector2d direction = Eigen::Rotation2Dd(truth.yaw_rad) * beam.direction_in_base;
    return direction.x() < -0.2 || direction.y() > 0.2;
  });
  const auto match = MakeMatcher(plan).Match(beams, Prior({1.33, -0.84, 0.48}));
  ASSERT_TRUE(match.has_value());
  EXPECT_NEAR(match->mean.x_m, truth.x_m, 0.01);
  EXPECT_NEAR(match->mean.y_m, truth.y_m, 0.01);
  EXPECT_NEAR(match->mean.yaw_rad, truth.yaw_rad, 0.008);
}

TEST(ScanMatcher, AlongACorridorThePriorHolds) {
  SyntheticRoom corridor{{0.0, 0.0, 60.0, 2.0}, {}};
  const Pose2 truth{30.0, 1.1, 0.1};
  auto beams = BeamsAt(corridor, truth);
  std::erase_if(beams, [](const Beam& beam) { return beam.range_m > 20.0; });
  const Distribution prior = Prior({30.08, 1.05, 0.08});
  const auto match = MakeMatcher(corridor.Plan()).Match(beams, prior);
  ASSERT_TRUE(match.has_value());
  EXPECT_NEAR(match->mean.y_m, 1.1, 0.003);
  EXPECT_NEAR(match->mean.yaw_rad, 0.1, 0.002);
  EXPECT_NEAR(match->mean.x_m, 30.08, 0.01);
  EXPECT_GT(match->covariance(0, 0), prior.covariance(0, 0));
  EXPECT_LT(match->covariance(1, 1), 0.2 * prior.covariance(1, 1));
}

TEST(ScanMatcher, RefusesALongWayAndScansWithoutWalls) {
  const SyntheticRoom room;
  const ScanMatcher matcher = MakeMatcher(room.Plan());
  const Pose2 truth{1.5, 1.5, 0.3};
  auto beams = BeamsAt(room, truth);
  for (std::size_t i = 0; i < beams.size(); i += 4) beams[i].range_m *= 0.5;
  EXPECT_TRUE(matcher.Match(beams, Prior(truth)).has_value());
  for (std::size_t i = 0; i < beams.size(); ++i) {
    if (i % 4 != 0) beams[i].range_m *= 0.6;
  }
  EXPECT_FALSE(matcher.Match(beams, Prior(truth)).has_value());
  EXPECT_FALSE(matcher.Match({}, Prior(truth)).has_value());
  Distribution far = Prior({truth.x_m + 0.18, truth.y_m, truth.yaw_rad});
  far.covariance *= 100.0;
  EXPECT_FALSE(matcher.Match(BeamsAt(room, truth), far).has_value());
}

}  // namespace
}  // namespace soundmap::localization
