#include "mapping/registration.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "mapping/point_thinning.h"

namespace soundmap::mapping {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

constexpr int kMaxIterations = 25;
constexpr double kDistanceShrink = 0.5;
constexpr double kConverged_m = 3e-4;
constexpr double kConverged_rad = 5e-5;

// In voxels of the map: how far a point looks for its surfel at the end, and how far an inlier may
// lie from its surface.
constexpr double kEndDistance_voxels = 0.75;
constexpr double kInlier_voxels = 0.3;

// Cauchy kernel, in voxels: never narrower than a good LIDAR's noise at 0.2 m.
constexpr double kMinKernel_voxels = 0.1;
constexpr double kMaxKernel_voxels = 1.0;
constexpr double kStdOfMedian = 1.4826;

// What one point's residual is taken to weigh against the prior. Much more than the noise of a
// point, since neighbouring points err together.
constexpr double kResidualStd_m = 0.15;

// A plane steeper than this speaks for x, y and yaw.
constexpr float kMaxVerticalNormal = 0.5f;

// What a registration from far away should reach.
constexpr double kGoodFit = 0.75;
constexpr double kGoodOverlap = 0.5;

// Points a voxel that are enough to align a scan.
constexpr double kPoints_voxels = 0.75;

// Points find their surfels anew when the pose has moved by so much, with what turns move a point
// so far away.
constexpr double kRematch_voxels = 0.05;
constexpr double kLever_m = 5.0;

struct Constraint {
  Eigen::Vector3f point_in_base;
  Eigen::Vector3f normal;  // of the surfel's plane, and its offset
  float offset_m;
  // Change of the residual with (x, y, z, rx, ry, rz), in map axes about the base.
  Eigen::Matrix<float, 6, 1> jacobian;
  float residual_m;
  bool steep;
};

struct Correspondences {
  std::vector<Constraint> constraints;
  int near = 0;  // points with a surfel
};

// Residuals and Jacobians at another pose, with the same surfels.
void Follow(const Eigen::Isometry3d& map_from_base, Correspondences& found) {
  const Eigen::Matrix3f rotation = map_from_base.linear().cast<float>();
  const Eigen::Vector3f place = map_from_base.translation().cast<float>();
  for (Constraint& constraint : found.constraints) {
    const Eigen::Vector3f arm = rotation * constraint.point_in_base;
    constraint.jacobian << constraint.normal, arm.cross(constraint.normal);
    constraint.residual_m = constraint.normal.dot(place + arm) - constraint.offset_m;
  }
}

void Match(std::span<const Eigen::Vector3f> point_in_base, const SurfaceMap& map,
           const Eigen::Isometry3d& map_from_base, double max_distance_m, Correspondences& result) {
  result.constraints.clear();
  result.near = 0;
  const Eigen::Matrix3f rotation = map_from_base.linear().cast<float>();
  const Eigen::Vector3f place = map_from_base.translation().cast<float>();
  for (const Eigen::Vector3f& point : point_in_base) {
    const Eigen::Vector3f arm = rotation * point;
    const Eigen::Vector3f in_map = place + arm;
    const Surfel* surfel = map.Nearest(in_map, max_distance_m);
    if (!surfel) continue;
    ++result.near;
    if (!surfel->has_plane()) continue;
    Constraint& constraint = result.constraints.emplace_back();
    constraint.point_in_base = point;
    constraint.normal = surfel->normal;
    constraint.offset_m = surfel->offset_m;
    constraint.steep = std::abs(surfel->normal.z()) <= kMaxVerticalNormal;
  }
  Follow(map_from_base, result);
}

double KernelWidth(const std::vector<Constraint>& constraints, double voxel_size_m) {
  std::vector<float> sizes_m;
  sizes_m.reserve(constraints.size());
  for (const Constraint& constraint : constraints) {
    sizes_m.push_back(std::abs(constraint.residual_m));
  }
  const auto middle = sizes_m.begin() + static_cast<std::ptrdiff_t>(sizes_m.size() / 2);
  std::nth_element(sizes_m.begin(), middle, sizes_m.end());
  return std::clamp(kStdOfMedian * *middle, kMinKernel_voxels * voxel_size_m,
                    kMaxKernel_voxels * voxel_size_m);
}

struct NormalEquations {
  Matrix6 information = Matrix6::Zero();
  Vector6 gradient = Vector6::Zero();
};

NormalEquations Sum(const std::vector<Constraint>& constraints, double voxel_size_m,
                    double point_weight) {
  NormalEquations sum;
  if (constraints.empty()) return sum;
  const double kernel_m = KernelWidth(constraints, voxel_size_m);
  for (const Constraint& constraint : constraints) {
    const double relative = constraint.residual_m / kernel_m;
    const double weight =
        point_weight / ((1.0 + relative * relative) * kResidualStd_m * kResidualStd_m);
    const Vector6 jacobian = constraint.jacobian.cast<double>();
    const Vector6 weighted = weight * jacobian;
    sum.information.noalias() += weighted * jacobian.transpose();
    sum.gradient += constraint.residual_m * weighted;
  }
  return sum;
}

Vector6 PriorWeight(const SearchRange& range) {
  Vector6 std;
  std << range.prior_std_m, range.prior_std_m, range.prior_std_z_m, range.prior_std_tilt_rad,
      range.prior_std_tilt_rad, range.prior_std_rad;
  return std.cwiseProduct(std).cwiseInverse();
}

Eigen::Matrix3d Rotation(const Eigen::Vector3d& turn_rad) {
  const double angle_rad = turn_rad.norm();
  if (angle_rad < 1e-12) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle_rad, turn_rad / angle_rad).toRotationMatrix();
}

Eigen::Vector3d TurnOf(const Eigen::Matrix3d& rotation) {
  const Eigen::AngleAxisd turn(rotation);
  return turn.angle() * turn.axis();
}

}  // namespace

Registration Register(std::span<const Eigen::Vector3f> point_in_base, const SurfaceMap& map,
                      const Eigen::Isometry3d& start_map_from_base, const SearchRange& range) {
  const double voxel_m = map.voxel_size_m();
  const double end_distance_m = kEndDistance_voxels * voxel_m;
  const Vector6 prior_weight = PriorWeight(range);
  Eigen::Isometry3d pose = start_map_from_base;
  double distance_m = std::max(range.start_distance_m, end_distance_m);
  Correspondences found;
  double matched_distance_m = 2.0 * distance_m;
  double moved_m = 0.0;  // since the last match
  // While the pose hardly moves, the points keep their surfels.
  const auto match_or_follow = [&] {
    if (distance_m < matched_distance_m || moved_m > kRematch_voxels * voxel_m) {
      Match(point_in_base, map, pose, distance_m, found);
      matched_distance_m = distance_m;
      moved_m = 0.0;
    } else {
      Follow(pose, found);
    }
  };
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    match_or_follow();
    NormalEquations sum = Sum(found.constraints, voxel_m, range.point_weight);
    Vector6 from_start;
    from_start << pose.translation() - start_map_from_base.translation(),
        TurnOf(pose.linear() * start_map_from_base.linear().transpose());
    sum.information.diagonal() += prior_weight;
    sum.gradient += prior_weight.cwiseProduct(from_start);
    const Vector6 step = -sum.information.ldlt().solve(sum.gradient);
    pose.translation() += step.head<3>();
    pose.linear() = Rotation(step.tail<3>()) * pose.linear();
    const double step_m = step.head<3>().norm();
    const double step_rad = step.tail<3>().norm();
    moved_m += step_m + step_rad * kLever_m;
    const bool still = step_m < kConverged_m && step_rad < kConverged_rad;
    if (still && distance_m <= end_distance_m) break;
    distance_m = std::max(distance_m * kDistanceShrink, end_distance_m);
  }

  Registration result;
  distance_m = end_distance_m;
  match_or_follow();
  double sum_m = 0.0;
  for (const Constraint& constraint : found.constraints) {
    if (!constraint.steep) continue;
    ++result.constraints;
    if (std::abs(constraint.residual_m) > kInlier_voxels * voxel_m) continue;
    ++result.inliers;
    sum_m += std::abs(constraint.residual_m);
  }
  if (!point_in_base.empty()) {
    result.overlap = static_cast<double>(found.near) / static_cast<double>(point_in_base.size());
  }
  if (result.inliers > 0) result.mean_residual_m = sum_m / result.inliers;
  Matrix6 map_axes_from_base = Matrix6::Zero();
  map_axes_from_base.topLeftCorner<3, 3>() = map_axes_from_base.bottomRightCorner<3, 3>() =
      pose.linear();
  result.information = map_axes_from_base.transpose() *
                       Sum(found.constraints, voxel_m, range.point_weight).information *
                       map_axes_from_base;
  result.information = 0.5 * (result.information + result.information.transpose()).eval();
  pose.linear() = Eigen::Quaterniond(pose.linear()).normalized().toRotationMatrix();
  result.map_from_base = pose;
  return result;
}

SurfacePyramid::SurfacePyramid(double finest_voxel_size_m, int levels) {
  double voxel_size_m = finest_voxel_size_m;
  for (int level = 0; level < levels; ++level, voxel_size_m *= 2.0) {
    levels_.emplace_back(voxel_size_m);
  }
}

void SurfacePyramid::Insert(std::span<const Eigen::Vector3f> point_in_map) {
  for (SurfaceMap& level : levels_) level.Insert(point_in_map);
}

void SurfacePyramid::FitPlanes() {
  for (SurfaceMap& level : levels_) level.FitPlanes();
}

Registration RegisterCoarseToFine(std::span<const Eigen::Vector3f> point_in_base,
                                  const SurfacePyramid& map,
                                  const Eigen::Isometry3d& start_map_from_base,
                                  const SearchRange& range) {
  Registration result;
  result.map_from_base = start_map_from_base;
  SearchRange level_range = range;
  // A point further out is swept past its surface by the error in rotation, which falls by half
  // from level to level.
  double reach_m = range.start_distance_m / std::max(range.prior_std_rad, range.prior_std_tilt_rad);
  for (auto level = map.levels().rbegin(); level != map.levels().rend(); ++level) {
    const bool finest = level + 1 == map.levels().rend();
    std::vector<Eigen::Vector3f> points =
        ThinPoints(point_in_base, kPoints_voxels * level->voxel_size_m());
    if (!finest) {
      std::erase_if(points,
                    [reach_m](const Eigen::Vector3f& point) { return point.norm() > reach_m; });
    }
    result = Register(points, *level, result.map_from_base, level_range);
    level_range.start_distance_m = level->voxel_size_m();  // two of the next level's voxels
    reach_m *= 2.0;
  }
  return result;
}

Registration RegisterFromFar(std::span<const Eigen::Vector3f> point_in_base,
                             const SurfacePyramid& map,
                             const Eigen::Isometry3d& start_map_from_base,
                             const SearchRange& range) {
  Registration best = RegisterCoarseToFine(point_in_base, map, start_map_from_base, range);
  const double turn_rad[] = {range.prior_std_tilt_rad, range.prior_std_tilt_rad,
                             range.prior_std_rad};
  for (int i = 0; i < 6 && (best.fit() < kGoodFit || best.overlap < kGoodOverlap); ++i) {
    Eigen::Isometry3d start = start_map_from_base;
    start.linear() = Rotation((i % 2 == 0 ? 1.0 : -1.0) * turn_rad[2 - i / 2] *
                              Eigen::Vector3d::Unit(2 - i / 2)) *
                     start.linear();
    const Registration other = RegisterCoarseToFine(point_in_base, map, start, range);
    if (other.inliers > best.inliers) best = other;
  }
  return best;
}

}  // namespace soundmap::mapping
