#include "mapping/pose_graph.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/manifold.h>
#include <ceres/problem.h>
#include <ceres/rotation.h>
#include <ceres/solver.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numeric>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "mapping/loop_consistency.h"

namespace soundmap::mapping {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

// Change of a pose: its place, and a rotation (vector) put before the starting one, in map axes.
using Parameters = std::array<double, 6>;

// The kernel's width falls in these steps to the given one.
constexpr double kGraduation[] = {4.0, 2.0, 1.0};
// Rounding may make an eigenvalue so much less than zero, relative to the largest.
constexpr double kNegativeTolerance = 1e-9;
// Poses further out than this are taken for faults.
constexpr double kMaxCoordinate_m = 1e7;

struct Node {
  Parameters change;
  Eigen::Quaterniond start_rotation;
};

// Residual of an edge, whitened.
class EdgeCost {
 public:
  EdgeCost(const PoseGraphEdge& edge, const Matrix6& whitening, const Node& from, const Node& to,
           const double* sqrt_weight)
      : measured_rotation_(edge.from_from_to.rotation()),
        measured_translation_(edge.from_from_to.translation()),
        whitening_(whitening),
        start_from_(from.start_rotation),
        start_to_(to.start_rotation),
        sqrt_weight_(sqrt_weight) {}

  template <typename T>
  bool operator()(const T* from, const T* to, T* residual) const {
    const Eigen::Quaternion<T> map_from_from = Rotation(from, start_from_);
    const Eigen::Quaternion<T> map_from_to = Rotation(to, start_to_);
    const Eigen::Matrix<T, 3, 1> between(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
    const Eigen::Quaternion<T> measured_from_from =
        measured_rotation_.conjugate().cast<T>() * map_from_from.conjugate();
    // to_measured_from_to
    const Eigen::Quaternion<T> rotation = measured_from_from * map_from_to;
    Eigen::Matrix<T, 6, 1> error;
    error.template head<3>() =
        measured_from_from * between -
        measured_rotation_.conjugate().cast<T>() * measured_translation_.cast<T>();
    const T quaternion[4] = {rotation.w(), rotation.x(), rotation.y(), rotation.z()};
    ceres::QuaternionToAngleAxis(quaternion, error.data() + 3);
    Eigen::Map<Eigen::Matrix<T, 6, 1>> whitened(residual);
    whitened = T(*sqrt_weight_) * (whitening_.cast<T>() * error);
    return true;
  }

 private:
  template <typename T>
  static Eigen::Quaternion<T> Rotation(const T* parameters, const Eigen::Quaterniond& start) {
    T change[4];
    ceres::AngleAxisToQuaternion(parameters + 3, change);
    return Eigen::Quaternion<T>(change[0], change[1], change[2], change[3]) * start.cast<T>();
  }

  Eigen::Quaterniond measured_rotation_;
  Eigen::Vector3d measured_translation_;
  Matrix6 whitening_;
  Eigen::Quaterniond start_from_, start_to_;
  const double* sqrt_weight_;
};

bool IsSound(const Eigen::Isometry3d& pose) {
  return pose.matrix().allFinite() &&
         pose.translation().cwiseAbs().maxCoeff() <= kMaxCoordinate_m &&
         (pose.linear() * pose.linear().transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 &&
         pose.linear().determinant() > 0.0;
}

absl::Status Check(std::span<const PoseGraphEdge> edges, std::span<const int> anchored,
                   const std::vector<Eigen::Isometry3d>& map_from_node) {
  const int nodes = static_cast<int>(map_from_node.size());
  const auto is_node = [nodes](int index) { return index >= 0 && index < nodes; };
  for (int i = 0; i < nodes; ++i) {
    if (!IsSound(map_from_node[i])) {
      return absl::InvalidArgumentError(
          absl::StrCat("the pose of node ", i, " of the pose graph is not a finite pose"));
    }
  }
  for (const int node : anchored) {
    if (!is_node(node)) {
      return absl::InvalidArgumentError(
          absl::StrCat("the pose graph has no node ", node, " to be anchored"));
    }
  }
  std::vector<int> root(map_from_node.size());
  std::iota(root.begin(), root.end(), 0);
  const auto find = [&root](int node) {
    while (root[node] != node) node = root[node] = root[root[node]];
    return node;
  };
  for (std::size_t i = 0; i < edges.size(); ++i) {
    const PoseGraphEdge& edge = edges[i];
    if (!is_node(edge.from) || !is_node(edge.to) || edge.from == edge.to) {
      return absl::InvalidArgumentError(absl::StrCat("edge ", i, " of the pose graph is from node ",
                                                     edge.from, " to node ", edge.to, " of ",
                                                     nodes));
    }
    if (!IsSound(edge.from_from_to) || !edge.information.allFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat("edge ", i, " of the pose graph is not finite or no pose"));
    }
    root[find(edge.from)] = find(edge.to);
  }
  std::vector<bool> held(map_from_node.size(), false);
  for (const int node : anchored) held[find(node)] = true;
  for (int i = 0; i < nodes; ++i) {
    if (!held[find(i)]) {
      return absl::InvalidArgumentError(
          absl::StrCat("node ", i, " of the pose graph has no way to an anchored one"));
    }
  }
  return absl::OkStatus();
}

// W with W^T W = information; empty if the matrix is not positive semidefinite.
std::optional<Matrix6> Whitening(const Matrix6& information) {
  const double scale = information.cwiseAbs().maxCoeff();
  if ((information - information.transpose()).cwiseAbs().maxCoeff() > 1e-6 * scale) return {};
  const Eigen::SelfAdjointEigenSolver<Matrix6> solver(information);
  const auto& values = solver.eigenvalues();
  if (values.minCoeff() < -kNegativeTolerance * scale) return {};
  return values.cwiseMax(0.0).cwiseSqrt().asDiagonal() * solver.eigenvectors().transpose();
}

// Twice the cost of an edge in full.
double SquaredResidual(const ceres::CostFunction& cost, const Node& from, const Node& to) {
  const double* parameters[] = {from.change.data(), to.change.data()};
  Eigen::Matrix<double, 6, 1> residual;
  cost.Evaluate(parameters, residual.data(), nullptr);
  return residual.squaredNorm();
}

}  // namespace

absl::Status PoseGraphConfig::Validate() const {
  if (!(loop_kernel_squared > 0.0 && loop_kernel_squared <= 1e6)) {
    return absl::InvalidArgumentError(
        "the pose graph's loop_kernel_squared must be positive and at most 1e6");
  }
  if (!(min_loop_weight >= 0.0 && min_loop_weight <= 1.0)) {
    return absl::InvalidArgumentError("the pose graph's min_loop_weight must be from 0 to 1");
  }
  if (max_iterations < 1 || max_iterations > 10000) {
    return absl::InvalidArgumentError("the pose graph's max_iterations must be from 1 to 10000");
  }
  return absl::OkStatus();
}

absl::Status OptimizePoseGraph(std::span<const PoseGraphEdge> edges, std::span<const int> anchored,
                               bool planar, const PoseGraphConfig& config,
                               std::vector<Eigen::Isometry3d>& map_from_node,
                               PoseGraphReport* report) {
  for (const absl::Status& status : {config.Validate(), Check(edges, anchored, map_from_node)}) {
    if (!status.ok()) return status;
  }
  PoseGraphReport result;
  result.weight.assign(edges.size(), 1.0);
  std::vector<double> sqrt_weight(edges.size(), 1.0);
  std::vector<Node> nodes;
  nodes.reserve(map_from_node.size());
  for (const Eigen::Isometry3d& pose : map_from_node) {
    const Eigen::Vector3d& place = pose.translation();
    nodes.push_back({{place.x(), place.y(), place.z(), 0.0, 0.0, 0.0},
                     Eigen::Quaterniond(pose.linear()).normalized()});
  }

  ceres::SubsetManifold on_plane(6, {2, 3, 4});
  ceres::Problem::Options ownership;
  ownership.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  std::vector<const ceres::CostFunction*> costs;  // owned by the problem
  for (std::size_t i = 0; i < edges.size(); ++i) {
    const PoseGraphEdge& edge = edges[i];
    const auto whitening = Whitening(edge.information);
    if (!whitening) {
      return absl::InvalidArgumentError(absl::StrCat(
          "the information of edge ", i, " of the pose graph is not positive semidefinite"));
    }
    auto* cost = new ceres::AutoDiffCostFunction<EdgeCost, 6, 6, 6>(
        new EdgeCost(edge, *whitening, nodes[edge.from], nodes[edge.to], &sqrt_weight[i]));
    problem.AddResidualBlock(cost, nullptr, nodes[edge.from].change.data(),
                             nodes[edge.to].change.data());
    costs.push_back(cost);
  }
  for (Node& node : nodes) {
    if (planar && problem.HasParameterBlock(node.change.data())) {
      problem.SetManifold(node.change.data(), &on_plane);
    }
  }
  std::vector<bool> is_anchored(nodes.size(), false);
  for (const int node : anchored) {
    is_anchored[node] = true;
    if (problem.HasParameterBlock(nodes[node].change.data())) {
      problem.SetParameterBlockConstant(nodes[node].change.data());
    }
  }

  ceres::Solver::Options options;
  options.num_threads = 1;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;  // no threads of a BLAS
  options.max_num_iterations = config.max_iterations;
  options.function_tolerance = 1e-9;
  options.parameter_tolerance = 1e-10;
  options.logging_type = ceres::SILENT;
  const auto solve = [&]() -> absl::Status {
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) {
      return absl::InternalError(
          absl::StrCat("the pose graph could not be solved: ", summary.message));
    }
    result.iterations += static_cast<int>(summary.iterations.size());
    return absl::OkStatus();
  };
  const auto squared_residual = [&](std::size_t i) {
    return SquaredResidual(*costs[i], nodes[edges[i].from], nodes[edges[i].to]);
  };

  // Of a loop in full, whatever it weighs.
  const auto unweighted = [&](std::size_t i) {
    const double weight = std::exchange(sqrt_weight[i], 1.0);
    const double squared = squared_residual(i);
    sqrt_weight[i] = weight;
    return squared;
  };
  for (std::size_t i = 0; i < edges.size(); ++i) result.initial_cost += 0.5 * squared_residual(i);
  if (!std::isfinite(result.initial_cost)) {
    return absl::InvalidArgumentError("the weights of the pose graph's edges are out of range");
  }
  // First the loops that agree with each other; then all, as far as they fit what came of that.
  const std::vector<bool> consistent =
      ConsistentLoops(edges, static_cast<int>(nodes.size()), planar, config.loop_kernel_squared);
  bool has_loops = false;
  for (std::size_t i = 0; i < edges.size(); ++i) {
    has_loops = has_loops || edges[i].loop;
    sqrt_weight[i] = consistent[i] ? 1.0 : 0.0;
  }
  if (absl::Status status = solve(); !status.ok()) return status;
  for (const double control : kGraduation) {
    if (!has_loops) break;
    const double width = control * config.loop_kernel_squared;
    for (std::size_t i = 0; i < edges.size(); ++i) {
      if (edges[i].loop) sqrt_weight[i] = width / (width + unweighted(i));
    }
    if (absl::Status status = solve(); !status.ok()) return status;
  }

  for (std::size_t i = 0; i < edges.size(); ++i) {
    result.final_cost += 0.5 * squared_residual(i);
    if (!edges[i].loop) continue;
    const double root = config.loop_kernel_squared / (config.loop_kernel_squared + unweighted(i));
    result.weight[i] = root * root;
    if (result.weight[i] < config.min_loop_weight) ++result.loops_refused;
  }
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (is_anchored[i]) continue;
    const Eigen::Vector3d turn(nodes[i].change[3], nodes[i].change[4], nodes[i].change[5]);
    const double angle_rad = turn.norm();
    Eigen::Quaterniond rotation = nodes[i].start_rotation;
    if (angle_rad > 0.0) {
      rotation = Eigen::AngleAxisd(angle_rad, turn / angle_rad) * rotation;
    }
    map_from_node[i].linear() = rotation.toRotationMatrix();
    map_from_node[i].translation() = Eigen::Vector3d(nodes[i].change.data());
  }
  if (report) *report = std::move(result);
  return absl::OkStatus();
}

}  // namespace soundmap::mapping
