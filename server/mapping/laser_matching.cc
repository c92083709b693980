#include "mapping/laser_matching.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "geometry/angles.h"

namespace soundmap::mapping {
namespace {

constexpr int kMaxIterations = 20;
constexpr double kEndDistance_m = 0.2;
constexpr double kDistanceShrink = 0.7;
constexpr double kConverged_m = 1e-4;
constexpr double kConverged_rad = 2e-5;

// Cauchy kernel: never narrower than an LRF's noise.
constexpr double kMinKernel_m = 0.02;
constexpr double kMaxKernel_m = 0.2;
constexpr double kStdOfMedian = 1.4826;
// It narrows by this from step to step at most: else the few walls that a corridor has across would
// count as outliers before they have drawn the scan along it.
constexpr double kKernelShrink = 0.6;
constexpr double kInlier_m = 0.06;

// What one point's residual is taken to weigh: more than its noise, since neighbouring points err
// together.
constexpr double kResidualStd_m = 0.05;

// A piece without a line, of furniture or the like: a point is drawn to its middle, which says
// little about where in the piece it belongs.
constexpr double kSpotWeight = 0.1;
constexpr double kMinSpotKernel_m = 0.06;

struct Constraint {
  double normal_x, normal_y;
  double residual_m;
  double lever_m;  // change of the residual with yaw
  double weight;
};

}  // namespace

LaserMatch MatchToLines(std::span<const Eigen::Vector2f> point_in_base, const LineMap& map,
                        const geometry::Pose2& start_map_from_base, const LaserSearchRange& range) {
  LaserMatch match;
  match.points = static_cast<int>(point_in_base.size());
  geometry::Pose2 pose = start_map_from_base;
  double distance_m = range.start_distance_m;
  double least_kernel_m = kMaxKernel_m;
  std::vector<Constraint> constraints;
  std::vector<Constraint> spots;
  std::vector<double> sorted_m;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();  // in the map's axes
  const Eigen::Vector3d prior_weight(1.0 / (range.prior_std_m * range.prior_std_m),
                                     1.0 / (range.prior_std_m * range.prior_std_m),
                                     1.0 / (range.prior_std_rad * range.prior_std_rad));
  bool last = false;
  for (int iteration = 0;; ++iteration) {
    constraints.clear();
    spots.clear();
    match.near = 0;
    const double c = std::cos(pose.yaw_rad), s = std::sin(pose.yaw_rad);
    for (const Eigen::Vector2f& point : point_in_base) {
      const double arm_x = c * point.x() - s * point.y();
      const double arm_y = s * point.x() + c * point.y();
      const Eigen::Vector2f in_map(static_cast<float>(pose.x_m + arm_x),
                                   static_cast<float>(pose.y_m + arm_y));
      const LinePiece* piece = map.Nearest(in_map, static_cast<float>(distance_m));
      if (!piece) continue;
      ++match.near;
      const double x_m = pose.x_m + arm_x, y_m = pose.y_m + arm_y;
      if (piece->has_line()) {
        const double nx = piece->normal.x(), ny = piece->normal.y();
        constraints.push_back(
            {nx, ny, nx * x_m + ny * y_m - piece->offset_m, arm_x * ny - arm_y * nx, 1.0});
      } else if (piece->is_spot) {
        spots.push_back({1.0, 0.0, x_m - piece->mean.x(), -arm_y, kSpotWeight});
        spots.push_back({0.0, 1.0, y_m - piece->mean.y(), arm_x, kSpotWeight});
      }
    }
    sorted_m.clear();
    for (const Constraint& constraint : constraints) {
      sorted_m.push_back(std::abs(constraint.residual_m));
    }
    double kernel_m = kMaxKernel_m;
    if (!sorted_m.empty()) {
      const auto middle = sorted_m.begin() + static_cast<std::ptrdiff_t>(sorted_m.size() / 2);
      std::nth_element(sorted_m.begin(), middle, sorted_m.end());
      kernel_m = std::clamp(kStdOfMedian * *middle, least_kernel_m, kMaxKernel_m);
    }
    information.setZero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    const auto add = [&](const Constraint& constraint, double width_m) {
      const double ratio = constraint.residual_m / width_m;
      const double weight =
          constraint.weight / ((1.0 + ratio * ratio) * kResidualStd_m * kResidualStd_m);
      const Eigen::Vector3d jacobian(constraint.normal_x, constraint.normal_y, constraint.lever_m);
      information += weight * jacobian * jacobian.transpose();
      gradient += weight * constraint.residual_m * jacobian;
    };
    for (const Constraint& constraint : constraints) add(constraint, kernel_m);
    for (const Constraint& spot : spots) add(spot, std::max(kernel_m, kMinSpotKernel_m));
    if (last || iteration == kMaxIterations) break;
    Eigen::Matrix3d hessian = information;
    hessian.diagonal() += prior_weight;
    gradient += prior_weight.cwiseProduct(
        Eigen::Vector3d(pose.x_m - start_map_from_base.x_m, pose.y_m - start_map_from_base.y_m,
                        geometry::NormalizeAngle(pose.yaw_rad - start_map_from_base.yaw_rad)));
    const Eigen::Vector3d step = -hessian.ldlt().solve(gradient);
    pose.x_m += step[0];
    pose.y_m += step[1];
    pose.yaw_rad = geometry::NormalizeAngle(pose.yaw_rad + step[2]);
    last = distance_m <= kEndDistance_m && least_kernel_m == kMinKernel_m &&
           step.head<2>().norm() < kConverged_m && std::abs(step[2]) < kConverged_rad;
    least_kernel_m = std::max(kMinKernel_m, least_kernel_m * kKernelShrink);
    distance_m = std::max(std::min(distance_m, kEndDistance_m), distance_m * kDistanceShrink);
  }
  match.map_from_base = pose;
  match.constraints = static_cast<int>(constraints.size());
  double residual_sum_m = 0.0;
  for (const Constraint& constraint : constraints) {
    if (std::abs(constraint.residual_m) > kInlier_m) continue;
    ++match.inliers;
    residual_sum_m += std::abs(constraint.residual_m);
  }
  if (match.inliers > 0) match.mean_residual_m = residual_sum_m / match.inliers;
  Eigen::Matrix3d map_from_base = Eigen::Matrix3d::Identity();
  map_from_base.topLeftCorner<2, 2>() = Eigen::Rotation2Dd(pose.yaw_rad).toRotationMatrix();
  match.information = map_from_base.transpose() * information * map_from_base;
  return match;
}

}  // namespace soundmap::mapping
