#include "mapping/pose_graph.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "geometry/angles.h"
#include "geometry/pose.h"

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using geometry::Pose2;
using ::testing::HasSubstr;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

Matrix6 Information(double std_m, double std_rad) {
  Eigen::Matrix<double, 6, 1> diagonal;
  diagonal << Vector3d::Constant(1.0 / (std_m * std_m)),
      Vector3d::Constant(1.0 / (std_rad * std_rad));
  return diagonal.asDiagonal();
}

Isometry3d Pose(const Vector3d& place, const Vector3d& turn) {
  const double angle_rad = turn.norm();
  Isometry3d pose = Isometry3d::Identity();
  pose.translation() = place;
  if (angle_rad > 0.0) {
    pose.linear() = Eigen::AngleAxisd(angle_rad, turn / angle_rad).toRotationMatrix();
  }
  return pose;
}

double Apart_m(const Isometry3d& a, const Isometry3d& b) {
  return (a.translation() - b.translation()).norm();
}

double Apart_rad(const Isometry3d& a, const Isometry3d& b) {
  return Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle();
}

// Ten equal steps of 1 m, which by a sure measurement lead only 9 m far: each gives 0.1 m.
TEST(PoseGraph, AnErrorIsSpreadEvenly) {
  for (const bool loop : {false, true}) {
    std::vector<PoseGraphEdge> edges;
    std::vector<Isometry3d> poses;
    for (int i = 0; i <= 10; ++i) poses.push_back(Pose({1.0 * i, 0, 0}, Vector3d::Zero()));
    for (int i = 0; i < 10; ++i) {
      edges.push_back({i, i + 1, Pose({1, 0, 0}, Vector3d::Zero()), Information(0.5, 0.1)});
    }
    edges.push_back({0, 10, Pose({9, 0, 0}, Vector3d::Zero()), Information(1e-4, 1e-4), loop});
    PoseGraphReport report;
    ASSERT_TRUE(OptimizePoseGraph(edges, std::vector{0}, false, {}, poses, &report).ok());
    for (int i = 0; i <= 10; ++i) {
      EXPECT_NEAR(poses[i].translation().x(), 0.9 * i, 1e-5) << i;
      EXPECT_NEAR(poses[i].translation().tail<2>().norm(), 0.0, 1e-9);
    }
    EXPECT_EQ(report.loops_refused, 0);
    EXPECT_GT(report.weight.back(), 0.99);
  }
}

// The share of each edge in the error is as its variance.
TEST(PoseGraph, AnErrorIsSpreadByTheInformation) {
  std::vector<Isometry3d> poses = {Isometry3d::Identity(), Pose({1, 0, 0}, Vector3d::Zero()),
                                   Pose({2, 0, 0}, Vector3d::Zero())};
  const std::vector<PoseGraphEdge> edges = {
      {0, 1, Pose({1, 0, 0}, Vector3d::Zero()), Information(0.1, 0.1)},
      {1, 2, Pose({1, 0, 0}, Vector3d::Zero()), Information(0.2, 0.1)},
      {2, 0, Pose({-2.6, 0, 0}, Vector3d::Zero()), Information(0.1, 0.1)}};
  ASSERT_TRUE(OptimizePoseGraph(edges, std::vector{0}, false, {}, poses).ok());
  EXPECT_NEAR(poses[1].translation().x(), 1.1, 1e-6);  // 0.6 m as 1 : 4 : 1
  EXPECT_NEAR(poses[2].translation().x(), 2.5, 1e-6);
}

// Information is in the frame of `to`: sure along its x, which lies along the map's y.
TEST(PoseGraph, InformationIsInTheFrameOfTheSecondPose) {
  Matrix6 along_x = Information(1.0, 0.01);
  along_x(0, 0) = 1e6;
  Matrix6 weak = Information(0.1, 0.01);
  const Vector3d quarter(0, 0, geometry::kPi / 2);
  std::vector<Isometry3d> poses = {Isometry3d::Identity(), Pose({1, 1, 0}, quarter)};
  const std::vector<PoseGraphEdge> edges = {{0, 1, Pose({1, 1, 0}, quarter), along_x},
                                            {0, 1, Pose({2, 2, 0}, quarter), weak}};
  ASSERT_TRUE(OptimizePoseGraph(edges, std::vector{0}, false, {}, poses).ok());
  EXPECT_NEAR(poses[1].translation().x(), 1.0 + 100.0 / 101.0, 1e-6);
  EXPECT_NEAR(poses[1].translation().y(), 1.0, 1e-3);
}

// A ring of poses in space with drifted starts comes back to the truth when every edge is true.
TEST(PoseGraph, TrueEdgesGiveTheTruth) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> any(-1.0, 1.0);
  std::vector<Isometry3d> truth, poses;
  for (int i = 0; i < 40; ++i) {
    const double phase = 2 * geometry::kPi * i / 40;
    truth.push_back(Pose({10 * std::cos(phase), 10 * std::sin(phase), any(random)},
                         {0.3 * any(random), 0.3 * any(random), phase - geometry::kPi}));
    poses.push_back(truth.back() *
                    Pose({any(random), any(random), any(random)},
                         Vector3d(any(random), any(random), any(random)) * (i == 0 ? 0.0 : 0.15)));
  }
  const Isometry3d frame = truth[0].inverse();
  for (Isometry3d& pose : truth) pose = frame * pose;
  for (Isometry3d& pose : poses) pose = frame * pose;
  poses[0] = truth[0];
  std::vector<PoseGraphEdge> edges;
  for (int i = 0; i < 40; ++i) {
    const int next = (i + 1) % 40;
    edges.push_back({i, next, truth[i].inverse() * truth[next], Information(0.1, 0.05), i == 39});
  }
  ASSERT_TRUE(OptimizePoseGraph(edges, std::vector{0}, false, {}, poses).ok());
  for (int i = 0; i < 40; ++i) {
    EXPECT_LT(Apart_m(poses[i], truth[i]), 1e-5) << i;
    EXPECT_LT(Apart_rad(poses[i], truth[i]), 1e-5) << i;
  }
}

struct Drive {
  std::vector<Isometry3d> truth, start;
  std::vector<PoseGraphEdge> edges;
};

// Two laps on a square of 20 m with odometry that drifts, and loops between the laps.
Drive TwoLaps(unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  Drive drive;
  Pose2 truth, odometry;
  for (int i = 0; i < 160; ++i) {
    drive.truth.push_back(truth.ToIsometry());
    drive.start.push_back(odometry.ToIsometry());
    Pose2 step{1.0, 0.0, i % 20 == 19 ? geometry::kPi / 2 : 0.0};
    truth = truth * step;
    step.x_m += 0.02 * noise(random);
    step.y_m += 0.02 * noise(random);
    step.yaw_rad += 0.003 + 0.01 * noise(random);
    odometry = odometry * step;
    if (i + 1 < 160) {
      drive.edges.push_back({i, i + 1, step.ToIsometry(), Information(0.03, 0.015)});
    }
  }
  for (int i = 0; i < 80; i += 4) {
    const Isometry3d error =
        Pose2{0.01 * noise(random), 0.01 * noise(random), 0.002 * noise(random)}.ToIsometry();
    drive.edges.push_back({i, i + 80, drive.truth[i].inverse() * drive.truth[i + 80] * error,
                           Information(0.02, 0.004), true});
  }
  return drive;
}

double MeanError_m(const std::vector<Isometry3d>& poses, const std::vector<Isometry3d>& truth) {
  double sum_m = 0.0;
  for (std::size_t i = 0; i < poses.size(); ++i) sum_m += Apart_m(poses[i], truth[i]);
  return sum_m / static_cast<double>(poses.size());
}

TEST(PoseGraph, FalseLoopsAmongTrueOnesAreRefused) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const Drive drive = TwoLaps(seed);
    ASSERT_GT(MeanError_m(drive.start, drive.truth), 1.0);
    auto without = drive.start;
    ASSERT_TRUE(OptimizePoseGraph(drive.edges, std::vector{0}, true, {}, without).ok());

    auto edges = drive.edges;
    const std::size_t true_edges = edges.size();
    std::mt19937 random(seed);
    for (int i = 0; i < 10; ++i) {
      const int from = static_cast<int>(random() % 160);
      const int to = (from + 30 + static_cast<int>(random() % 20)) % 160;
      edges.push_back(
          {from, to, Pose2{0.2, -0.3, 0.1}.ToIsometry(), Information(0.02, 0.004), true});
    }
    auto with = drive.start;
    PoseGraphReport report;
    ASSERT_TRUE(OptimizePoseGraph(edges, std::vector{0}, true, {}, with, &report).ok());
    EXPECT_EQ(report.loops_refused, 10) << seed;
    for (std::size_t i = 0; i < edges.size(); ++i) {
      if (i < true_edges) {
        EXPECT_GT(report.weight[i], 0.3) << seed << ' ' << i;
      } else {
        EXPECT_LT(report.weight[i], 1e-3) << seed << ' ' << i;
      }
    }
    EXPECT_LT(MeanError_m(with, without), 0.01) << seed;
  }
}

// One loop alone counts only if the odometry may err by so much.
TEST(PoseGraph, ALoopMustAgreeWithTheChain) {
  for (const double off_m : {1.0, 40.0}) {
    Drive drive = TwoLaps(1);
    drive.edges.resize(159);
    drive.start.clear();
    for (int i = 0; i < 160; ++i) {
      drive.start.push_back(i == 0 ? drive.truth[0]
                                   : drive.start[i - 1] * drive.edges[i - 1].from_from_to);
    }
    const Isometry3d between = drive.start[10].inverse() * drive.start[150];
    drive.edges.push_back(
        {10, 150, Eigen::Translation3d(off_m, 0, 0) * between, Information(0.02, 0.004), true});
    auto poses = drive.start;
    PoseGraphReport report;
    ASSERT_TRUE(OptimizePoseGraph(drive.edges, std::vector{0}, true, {}, poses, &report).ok());
    EXPECT_EQ(report.loops_refused, off_m > 10.0 ? 1 : 0) << off_m;
    EXPECT_NEAR(Apart_m(poses[150], drive.start[150]), off_m > 10.0 ? 0.0 : off_m, 0.1 * off_m);
  }
}

TEST(PoseGraph, AnchorsStayExactlyAndPlanesFlat) {
  const Drive drive = TwoLaps(3);
  const Isometry3d tilt = Pose({5, 6, 0.3}, {0.02, -0.01, 0.0});
  auto start = drive.start;
  for (Isometry3d& pose : start) pose = pose * tilt;
  auto poses = start;
  ASSERT_TRUE(OptimizePoseGraph(drive.edges, std::vector{7, 12}, true, {}, poses).ok());
  EXPECT_EQ(poses[7].matrix(), start[7].matrix());
  EXPECT_EQ(poses[12].matrix(), start[12].matrix());
  double moved_m = 0.0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    moved_m += Apart_m(poses[i], start[i]);
    EXPECT_EQ(poses[i].translation().z(), start[i].translation().z());
    // The vertical, seen from the robot, does not change with the yaw.
    EXPECT_LT((poses[i].linear().row(2) - start[i].linear().row(2)).norm(), 1e-12);
  }
  EXPECT_GT(moved_m, 10.0);

  auto again = start;
  ASSERT_TRUE(OptimizePoseGraph(drive.edges, std::vector{7, 12}, true, {}, again).ok());
  for (std::size_t i = 0; i < poses.size(); ++i) EXPECT_EQ(again[i].matrix(), poses[i].matrix());
}

TEST(PoseGraph, HostileInputIsRefusedAndChangesNothing) {
  const std::vector<Isometry3d> start = {Isometry3d::Identity(), Pose({1, 0, 0}, {0, 0, 0.1}),
                                         Pose({2, 0, 0}, {0, 0, 0.2})};
  const PoseGraphEdge good{0, 1, Pose({1, 0, 0}, {0, 0, 0.2}), Information(0.1, 0.1)};
  const PoseGraphEdge other{1, 2, Pose({1, 0, 0}, {0, 0, 0.2}), Information(0.1, 0.1)};
  const auto refused = [&](std::vector<PoseGraphEdge> edges, std::vector<int> anchored,
                           std::vector<Isometry3d> poses) {
    const auto before = poses;
    const absl::Status status = OptimizePoseGraph(edges, anchored, false, {}, poses);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    for (std::size_t i = 0; i < poses.size(); ++i) {
      EXPECT_EQ(std::memcmp(poses[i].data(), before[i].data(), sizeof(double) * 16), 0);
    }
    return std::string(status.message());
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(refused({good}, {0}, start), HasSubstr("node 2"));
  EXPECT_THAT(refused({good, other}, {}, start), HasSubstr("node 0"));
  EXPECT_THAT(refused({good, other}, {3}, start), HasSubstr("no node 3"));
  EXPECT_THAT(refused({good, other}, {-1}, start), HasSubstr("no node -1"));
  for (const auto& [from, to] : {std::pair{0, 3}, {-1, 1}, {1, 1}}) {
    PoseGraphEdge edge = good;
    edge.from = from;
    edge.to = to;
    EXPECT_THAT(refused({good, other, edge}, {0}, start), HasSubstr("edge 2"));
  }
  PoseGraphEdge edge = good;
  edge.from_from_to.translation().x() = nan;
  EXPECT_THAT(refused({good, other, edge}, {0}, start), HasSubstr("edge 2"));
  edge = good;
  edge.from_from_to.linear() *= 2.0;
  EXPECT_THAT(refused({good, other, edge}, {0}, start), HasSubstr("edge 2"));
  edge = good;
  edge.information(2, 2) = -1.0;
  EXPECT_THAT(refused({good, other, edge}, {0}, start), HasSubstr("semidefinite"));
  edge.information(2, 2) = nan;
  EXPECT_THAT(refused({good, other, edge}, {0}, start), HasSubstr("edge 2"));
  edge = good;
  edge.information(0, 5) = 50.0;  // not symmetric
  EXPECT_THAT(refused({good, other, edge}, {0}, start), HasSubstr("semidefinite"));
  auto broken = start;
  broken[2].translation().y() = nan;
  EXPECT_THAT(refused({good, other}, {0}, broken), HasSubstr("node 2"));

  auto poses = start;
  PoseGraphConfig config;
  config.loop_kernel_squared = nan;
  EXPECT_FALSE(
      OptimizePoseGraph(std::vector{good, other}, std::vector{0}, false, config, poses).ok());
  // What is open on every side stays; nothing at all is fine.
  edge = other;
  edge.information.setZero();
  EXPECT_TRUE(OptimizePoseGraph(std::vector{good, edge}, std::vector{0}, false, {}, poses).ok());
  EXPECT_LT(Apart_m(poses[2], start[2]), 1e-9);
  std::vector<Isometry3d> none;
  EXPECT_TRUE(OptimizePoseGraph({}, {}, false, {}, none).ok());
}

}  // namespace
}  // namespace soundmap::mapping
