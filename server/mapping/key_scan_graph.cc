#include "mapping/key_scan_graph.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <queue>
#include <utility>

#include "mapping/point_thinning.h"

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

// Drift of registration from scan to scan: 2 cm and 0.2 degrees after a metre, growing with the
// root of the way; and at least this in each.
constexpr double kDrift_m2_per_m = 4e-4;
constexpr double kDrift_rad2_per_m = 1.2e-5;
constexpr double kLeast_m2 = 1e-6;
constexpr double kLeast_rad2 = 4e-8;

// Between places seen at different times, whose surfaces were mapped apart.
constexpr double kApart_m = 0.02;
constexpr double kApart_rad = 0.003;

// The odometry of wheels that slip now and then.
constexpr double kOdometry_m = 0.02;
constexpr double kOdometryOfWay = 0.1;
constexpr double kOdometry_rad = 0.01;
constexpr double kOdometryOfTurn = 0.05;
constexpr double kOdometryTurn_rad_per_m = 0.03;
// The floor keeps z, roll and pitch.
constexpr double kFloor_m = 0.02;
constexpr double kFloor_rad = 0.01;

// An error of the yaw shows at surfaces so far away.
constexpr double kLever_m = 5.0;
// Nearly a voxel of the surfaces; scans not further along the way than this hold together anyway.
constexpr double kTrusted_m = 0.15;
constexpr double kTrustedWay_m = 8.0;

double TurnOf(const Isometry3d& pose) { return Eigen::AngleAxisd(pose.linear()).angle(); }

}  // namespace

double ScanUncertainty::std_m() const { return std::sqrt(variance_m2); }

double ScanUncertainty::combined_m() const {
  return std::sqrt(variance_m2 + kLever_m * kLever_m * variance_rad2);
}

bool Trusted(const ScanUncertainty& uncertainty) {
  return uncertainty.combined_m() <= kTrusted_m || uncertainty.way_m <= kTrustedWay_m;
}

Isometry3d KeyScanGraph::Between(int from, int to) const {
  if (from == kBuilding) return scans[to].map_from_base;
  return scans[from].map_from_base.inverse() * scans[to].map_from_base;
}

std::vector<ScanUncertainty> KeyScanGraph::UncertaintyFrom(int scan) const {
  constexpr double kInfinite = std::numeric_limits<double>::infinity();
  const std::size_t building = scans.size();  // the node after the last scan
  const auto index = [building](int node) {
    return node == kBuilding ? building : static_cast<std::size_t>(node);
  };
  struct Step {
    std::size_t to;
    double variance_m2, variance_rad2, way_m;
  };
  std::vector<std::vector<Step>> steps(scans.size() + 1);
  for (const PoseGraphEdge& edge : edges) {
    const Matrix6 covariance =
        (edge.information + Matrix6::Identity() * 1e-6).ldlt().solve(Matrix6::Identity());
    const Step step{
        index(edge.to), std::max(covariance(0, 0), covariance(1, 1)) + std::abs(covariance(0, 1)),
        covariance(5, 5), edge.from == kBuilding ? 0.0 : edge.from_from_to.translation().norm()};
    steps[index(edge.from)].push_back(step);
    steps[index(edge.to)].push_back(
        {index(edge.from), step.variance_m2, step.variance_rad2, step.way_m});
  }
  std::vector<ScanUncertainty> found(scans.size() + 1, {kInfinite, kInfinite, kInfinite});
  using Open = std::pair<double, std::size_t>;
  std::priority_queue<Open, std::vector<Open>, std::greater<>> open;
  found[index(scan)] = {};
  open.push({0.0, index(scan)});
  while (!open.empty()) {
    const auto [distance, node] = open.top();
    open.pop();
    const ScanUncertainty here = found[node];
    if (distance > here.combined_m()) continue;
    for (const Step& step : steps[node]) {
      const ScanUncertainty next{here.variance_m2 + step.variance_m2,
                                 here.variance_rad2 + step.variance_rad2, here.way_m + step.way_m};
      if (!(next.combined_m() < found[step.to].combined_m())) continue;
      found[step.to] = next;
      open.push({next.combined_m(), step.to});
    }
  }
  found.pop_back();
  return found;
}

absl::Status KeyScanGraph::Optimize(PoseGraphReport* report) {
  std::vector<Isometry3d> poses;
  std::vector<int> anchored;
  bool with_building = false;
  std::vector<PoseGraphEdge> all = edges;
  const int building = static_cast<int>(scans.size());
  for (PoseGraphEdge& edge : all) {
    if (edge.from != kBuilding) continue;
    edge.from = building;
    with_building = true;
  }
  for (std::size_t i = 0; i < scans.size(); ++i) {
    poses.push_back(scans[i].map_from_base);
    if (scans[i].fixed) anchored.push_back(static_cast<int>(i));
  }
  if (with_building) {
    poses.push_back(Isometry3d::Identity());
    anchored.push_back(building);
  }
  const absl::Status status = OptimizePoseGraph(all, anchored, /*planar=*/true, {}, poses, report);
  if (!status.ok()) return status;
  for (std::size_t i = 0; i < scans.size(); ++i) scans[i].map_from_base = poses[i];
  return absl::OkStatus();
}

void KeyScanGraph::Append(KeyScanGraph&& other, const Isometry3d& map_from_other) {
  const int offset = static_cast<int>(scans.size());
  for (KeyScan& scan : other.scans) {
    scan.map_from_base = map_from_other * scan.map_from_base;
    scans.push_back(std::move(scan));
  }
  for (PoseGraphEdge& edge : other.edges) {
    if (edge.from != kBuilding) edge.from += offset;
    edge.to += offset;
    edges.push_back(edge);
  }
  other.scans.clear();
  other.edges.clear();
}

Matrix6 EdgeInformation(const Isometry3d& from_from_to, const Matrix6& registration_information,
                        EdgeKind kind) {
  const double way_m = from_from_to.translation().norm();
  Vector6 least;
  least << Eigen::Vector3d::Constant(kLeast_m2 + kDrift_m2_per_m * way_m),
      Eigen::Vector3d::Constant(kLeast_rad2 + kDrift_rad2_per_m * way_m);
  const double odometry_m = kOdometry_m + kOdometryOfWay * way_m;
  const double odometry_rad =
      kOdometry_rad + kOdometryOfTurn * TurnOf(from_from_to) + kOdometryTurn_rad_per_m * way_m;
  Vector6 prior;
  prior << odometry_m, odometry_m, kFloor_m, kFloor_rad, kFloor_rad, odometry_rad;
  prior = prior.cwiseProduct(prior).cwiseInverse();
  if (kind == EdgeKind::kLoop) {
    prior[0] = prior[1] = prior[5] = 1e-3;
    least.head<3>().setConstant(kApart_m * kApart_m);
    least.tail<3>().setConstant(kApart_rad * kApart_rad);
  }
  const Matrix6 information = registration_information + Matrix6(prior.asDiagonal());
  const Matrix6 covariance = information.inverse() + Matrix6(least.asDiagonal());
  const Matrix6 result = covariance.inverse();
  return 0.5 * (result + result.transpose());
}

std::vector<Eigen::Vector3f> PointsAround(const KeyScanGraph& graph, int scan, double radius_m,
                                          int max_scans, double spacing_m) {
  const std::vector<ScanUncertainty> uncertainty = graph.UncertaintyFrom(scan);
  std::vector<std::pair<double, int>> near;
  for (int i = 0; i < static_cast<int>(graph.scans.size()); ++i) {
    const double distance_m = graph.Between(scan, i).translation().norm();
    if (Trusted(uncertainty[i]) && distance_m <= radius_m) near.push_back({distance_m, i});
  }
  std::sort(near.begin(), near.end());
  // Evenly over the distances.
  const std::size_t stride =
      std::max<std::size_t>(1, (near.size() + max_scans - 1) / static_cast<std::size_t>(max_scans));
  std::vector<Eigen::Vector3f> points;
  for (std::size_t i = 0; i < near.size(); i += stride) {
    const KeyScan& other = graph.scans[near[i].second];
    const Eigen::Isometry3f base_from_other = graph.Between(scan, near[i].second).cast<float>();
    for (const Eigen::Vector3f& point : ThinPoints(other.point_in_base, spacing_m)) {
      points.push_back(base_from_other * point);
    }
  }
  return ThinPoints(points, spacing_m);
}

}  // namespace soundmap::mapping
