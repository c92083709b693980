#include "mapping/registration.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

namespace soundmap::mapping {
namespace {

constexpr int kMaxIterations = 25;
constexpr double kEndDistance_m = 0.15;
constexpr double kDistanceShrink = 0.7;
constexpr double kConverged_m = 1e-4;
constexpr double kConverged_rad = 2e-5;

// Cauchy kernel: never narrower than a good LIDAR's noise.
constexpr double kMinKernel_m = 0.02;
constexpr double kMaxKernel_m = 0.2;
constexpr double kStdOfMedian = 1.4826;

// What one point's residual is taken to weigh against the prior. Much more than the noise of a
// point, since neighbouring points err together.
constexpr double kResidualStd_m = 0.3;

// A plane steeper than this speaks for x, y and yaw.
constexpr float kMaxVerticalNormal = 0.5f;
constexpr double kInlier_m = 0.06;

struct Constraint {
  float normal_x, normal_y;
  float residual_m;
  float lever_m;  // change of the residual with yaw
};

struct Correspondences {
  std::vector<Constraint> constraints;
  int near = 0;  // points with a surfel
};

Correspondences Match(std::span<const Eigen::Vector3f> point_in_base, const SurfaceMap& map,
                      const geometry::Pose2& map_from_base, double max_distance_m) {
  Correspondences result;
  result.constraints.reserve(point_in_base.size());
  const double cos_yaw = std::cos(map_from_base.yaw_rad);
  const double sin_yaw = std::sin(map_from_base.yaw_rad);
  for (const Eigen::Vector3f& point : point_in_base) {
    // Arm from the base to the point along the map's axes.
    const double arm_x = cos_yaw * point.x() - sin_yaw * point.y();
    const double arm_y = sin_yaw * point.x() + cos_yaw * point.y();
    const Eigen::Vector3f in_map(static_cast<float>(map_from_base.x_m + arm_x),
                                 static_cast<float>(map_from_base.y_m + arm_y), point.z());
    const Surfel* surfel = map.Nearest(in_map, max_distance_m);
    if (!surfel) continue;
    ++result.near;
    if (!surfel->has_plane() || std::abs(surfel->normal.z()) > kMaxVerticalNormal) continue;
    const float lever_m = static_cast<float>(arm_x) * surfel->normal.y() -
                          static_cast<float>(arm_y) * surfel->normal.x();
    result.constraints.push_back({surfel->normal.x(), surfel->normal.y(),
                                  surfel->normal.dot(in_map) - surfel->offset_m, lever_m});
  }
  return result;
}

double KernelWidth(const std::vector<Constraint>& constraints) {
  std::vector<float> sizes_m;
  sizes_m.reserve(constraints.size());
  for (const Constraint& constraint : constraints) {
    sizes_m.push_back(std::abs(constraint.residual_m));
  }
  const auto middle = sizes_m.begin() + static_cast<std::ptrdiff_t>(sizes_m.size() / 2);
  std::nth_element(sizes_m.begin(), middle, sizes_m.end());
  return std::clamp(kStdOfMedian * *middle, kMinKernel_m, kMaxKernel_m);
}

// The Gauss-Newton step (x, y, yaw) of the residuals and of the prior, whose deviation from the
// starting pose is `from_start`.
Eigen::Vector3d Step(const std::vector<Constraint>& constraints, const Eigen::Vector3d& from_start,
                     const SearchRange& range) {
  const Eigen::Vector3d prior_weight(1.0 / (range.prior_std_m * range.prior_std_m),
                                     1.0 / (range.prior_std_m * range.prior_std_m),
                                     1.0 / (range.prior_std_rad * range.prior_std_rad));
  Eigen::Matrix3d information = prior_weight.asDiagonal();
  Eigen::Vector3d gradient = prior_weight.cwiseProduct(from_start);
  if (!constraints.empty()) {
    const double kernel_m = KernelWidth(constraints);
    for (const Constraint& constraint : constraints) {
      const double relative = constraint.residual_m / kernel_m;
      const double weight = 1.0 / ((1.0 + relative * relative) * kResidualStd_m * kResidualStd_m);
      const Eigen::Vector3d jacobian(constraint.normal_x, constraint.normal_y, constraint.lever_m);
      information += weight * jacobian * jacobian.transpose();
      gradient += weight * constraint.residual_m * jacobian;
    }
  }
  return -information.ldlt().solve(gradient);
}

}  // namespace

Registration Register(std::span<const Eigen::Vector3f> point_in_base, const SurfaceMap& map,
                      const geometry::Pose2& start_map_from_base, const SearchRange& range) {
  Registration result;
  geometry::Pose2 pose = start_map_from_base;
  Eigen::Vector3d from_start = Eigen::Vector3d::Zero();
  double distance_m = std::max(range.start_distance_m, kEndDistance_m);
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const Correspondences found = Match(point_in_base, map, pose, distance_m);
    const Eigen::Vector3d step = Step(found.constraints, from_start, range);
    from_start += step;
    pose = {start_map_from_base.x_m + from_start.x(), start_map_from_base.y_m + from_start.y(),
            start_map_from_base.yaw_rad + from_start.z()};
    const bool still = step.head<2>().norm() < kConverged_m && std::abs(step.z()) < kConverged_rad;
    if (still && distance_m <= kEndDistance_m) break;
    distance_m = std::max(distance_m * kDistanceShrink, kEndDistance_m);
  }

  const Correspondences found = Match(point_in_base, map, pose, kEndDistance_m);
  double sum_m = 0.0;
  for (const Constraint& constraint : found.constraints) {
    if (std::abs(constraint.residual_m) > kInlier_m) continue;
    ++result.inliers;
    sum_m += std::abs(constraint.residual_m);
  }
  result.constraints = static_cast<int>(found.constraints.size());
  if (!point_in_base.empty()) {
    result.overlap = static_cast<double>(found.near) / static_cast<double>(point_in_base.size());
  }
  if (result.inliers > 0) result.mean_residual_m = sum_m / result.inliers;
  result.map_from_base = pose * geometry::Pose2{};  // brings yaw into (-pi, pi]
  return result;
}

}  // namespace soundmap::mapping
