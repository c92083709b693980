#pragma once

#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "absl/status/status.h"

namespace soundmap::mapping {

// What was measured between two poses.
struct PoseGraphEdge {
  int from = 0;  // indices of nodes
  int to = 0;
  Eigen::Isometry3d from_from_to = Eigen::Isometry3d::Identity();
  // Inverse covariance of (x, y, z, rx, ry, rz): the translation (metres) and the rotation vector
  // (radians) of to_measured_from_to, in the frame of the measured `to`. Positive semidefinite;
  // zeros leave a direction open.
  Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Identity();
  // May be altogether wrong: it counts only as far as it agrees with the rest of the graph.
  bool loop = false;
};

struct PoseGraphConfig {
  // Squared Mahalanobis distance at which a loop has lost three quarters of its weight (and of
  // beyond which it is soon nothing): the 99 % quantile of chi-squared for 6 degrees of freedom.
  double loop_kernel_squared = 16.8;
  // A loop that ends up with less weight than this is reported as refused.
  double min_loop_weight = 0.1;
  int max_iterations = 50;  // of Levenberg-Marquardt, with one set of loop weights

  absl::Status Validate() const;
};

struct PoseGraphReport {
  int iterations = 0;
  double initial_cost = 0.0;  // half the sum of the squared residuals, loops in full
  double final_cost = 0.0;    // the same, loops by their weight
  int loops_refused = 0;
  std::vector<double> weight;  // of each edge, 0 to 1; 1 for those that are no loops
};

// Moves the poses so that the edges are met best (least squares, Ceres). The `anchored` poses stay
// exactly; with `planar` each pose keeps z, roll and pitch. The start takes the loops that agree
// with the chain and with each other (ConsistentLoops); from there each loop counts as far as it
// fits (Geman-McClure kernel, graduated: Yang et al. 2020). `map_from_node` holds the starting
// poses and gets the result; it is as before on error. InvalidArgument: an index out of range,
// numbers that are not finite, an information matrix that is not positive semidefinite, a node
// without a way to an anchored one. Deterministic.
absl::Status OptimizePoseGraph(std::span<const PoseGraphEdge> edges, std::span<const int> anchored,
                               bool planar, const PoseGraphConfig& config,
                               std::vector<Eigen::Isometry3d>& map_from_node,
                               PoseGraphReport* report = nullptr);

}  // namespace soundmap::mapping
