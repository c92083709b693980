#include "mapping/loop_consistency.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <deque>
#include <numeric>
#include <utility>

namespace soundmap::mapping {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

// What an edge leaves open is taken to be known so badly: 1 km, or that many radians.
constexpr double kMinInformation = 1e-6;
// On a plane, so well: 1 cm.
constexpr double kPlaneInformation = 1e4;
// More loops than this are not compared with each other (their number squared).
constexpr std::size_t kMaxLoops = 3000;

Eigen::Matrix3d Skew(const Vector3d& v) {
  Eigen::Matrix3d skew;
  skew << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return skew;
}

// Takes a small change (x, y, z, rx, ry, rz) after the transform to the equal one before it.
Matrix6 Adjoint(const Isometry3d& transform) {
  Matrix6 adjoint = Matrix6::Zero();
  adjoint.topLeftCorner<3, 3>() = adjoint.bottomRightCorner<3, 3>() = transform.linear();
  adjoint.topRightCorner<3, 3>() = Skew(transform.translation()) * transform.linear();
  return adjoint;
}

Matrix6 Moved(const Isometry3d& transform, const Matrix6& covariance) {
  const Matrix6 adjoint = Adjoint(transform);
  return adjoint * covariance * adjoint.transpose();
}

Matrix6 Covariance(const PoseGraphEdge& edge, bool planar) {
  Vector6 least = Vector6::Constant(kMinInformation);
  if (planar) least.segment<3>(2).setConstant(kPlaneInformation);
  const Matrix6 information = edge.information + Matrix6(least.asDiagonal());
  return information.ldlt().solve(Matrix6::Identity());
}

// The chain as a forest, each tree in the frame of its root.
struct TreeNode {
  int parent = -1;
  int depth = 0;
  int root = 0;
  Isometry3d root_from_node = Isometry3d::Identity();
  Matrix6 covariance = Matrix6::Zero();  // of the way from the root, as a change in its frame
};

std::vector<TreeNode> MakeForest(std::span<const PoseGraphEdge> edges, int nodes, bool planar) {
  std::vector<std::vector<std::size_t>> edges_of(static_cast<std::size_t>(nodes));
  for (std::size_t i = 0; i < edges.size(); ++i) {
    if (edges[i].loop) continue;
    edges_of[edges[i].from].push_back(i);
    edges_of[edges[i].to].push_back(i);
  }
  std::vector<TreeNode> forest(edges_of.size());
  std::vector<bool> reached(edges_of.size(), false);
  for (int root = 0; root < nodes; ++root) {
    if (reached[root]) continue;
    reached[root] = true;
    forest[root].root = root;
    std::deque<int> open = {root};
    while (!open.empty()) {
      const int here = open.front();
      open.pop_front();
      for (const std::size_t i : edges_of[here]) {
        const PoseGraphEdge& edge = edges[i];
        const bool forward = edge.from == here;
        const int next = forward ? edge.to : edge.from;
        if (reached[next]) continue;
        reached[next] = true;
        TreeNode& node = forest[next];
        const TreeNode& parent = forest[here];
        node.parent = here;
        node.depth = parent.depth + 1;
        node.root = root;
        node.root_from_node =
            parent.root_from_node * (forward ? edge.from_from_to : edge.from_from_to.inverse());
        // Information is in the frame of the edge's end.
        const Isometry3d& root_from_end = forward ? node.root_from_node : parent.root_from_node;
        node.covariance = parent.covariance + Moved(root_from_end, Covariance(edge, planar));
        open.push_back(next);
      }
    }
  }
  return forest;
}

class Cycles {
 public:
  Cycles(std::span<const PoseGraphEdge> edges, int nodes, bool planar)
      : forest_(MakeForest(edges, nodes, planar)), planar_(planar) {}

  bool Joined(int a, int b) const { return forest_[a].root == forest_[b].root; }

  // Squared Mahalanobis distance of the cycle of a loop and the chain.
  double OfOne(const PoseGraphEdge& loop) const {
    const Isometry3d cycle = loop.from_from_to.inverse() * Between(loop.from, loop.to);
    return Squared(cycle, Covariance(loop, planar_) + ChainCovariance(loop.from, loop.to));
  }

  // Of two loops and the chain between their ends.
  double OfTwo(const PoseGraphEdge& a, const PoseGraphEdge& b) const {
    // a.to -> a.from -> b.from -> b.to -> a.to
    const Isometry3d to_from_from = a.from_from_to.inverse();
    const Isometry3d to_from_other_from = to_from_from * Between(a.from, b.from);
    const Isometry3d to_from_other_to = to_from_other_from * b.from_from_to;
    const Isometry3d cycle = to_from_other_to * Between(b.to, a.to);
    const Matrix6 covariance =
        Covariance(a, planar_) + Moved(to_from_other_from, ChainCovariance(a.from, b.from)) +
        Moved(to_from_other_to, Covariance(b, planar_)) + ChainCovariance(b.to, a.to);
    return Squared(cycle, covariance);
  }

 private:
  Isometry3d Between(int from, int to) const {
    return forest_[from].root_from_node.inverse() * forest_[to].root_from_node;
  }

  // Of the way along the tree, as a change in the frame of `to`.
  Matrix6 ChainCovariance(int from, int to) const {
    int a = from, b = to;
    while (a != b) {
      int& deeper = forest_[a].depth > forest_[b].depth ? a : b;
      deeper = forest_[deeper].parent;
    }
    return Moved(forest_[to].root_from_node.inverse(),
                 forest_[from].covariance + forest_[to].covariance - 2.0 * forest_[a].covariance);
  }

  double Squared(const Isometry3d& cycle, const Matrix6& covariance) const {
    const Eigen::AngleAxisd turn(cycle.linear());
    Vector6 error;
    error << cycle.translation(), turn.angle() * turn.axis();
    if (!planar_) return error.dot(covariance.ldlt().solve(error));
    const int plane[] = {0, 1, 5};
    Eigen::Matrix3d block;
    Vector3d part;
    for (int row = 0; row < 3; ++row) {
      part[row] = error[plane[row]];
      for (int column = 0; column < 3; ++column) {
        block(row, column) = covariance(plane[row], plane[column]);
      }
    }
    return part.dot(block.ldlt().solve(part));
  }

  std::vector<TreeNode> forest_;
  bool planar_;
};

}  // namespace

std::vector<bool> ConsistentLoops(std::span<const PoseGraphEdge> edges, int nodes, bool planar,
                                  double max_squared) {
  const Cycles cycles(edges, nodes, planar);
  std::vector<bool> consistent(edges.size(), true);
  std::vector<std::size_t> loops;
  for (std::size_t i = 0; i < edges.size(); ++i) {
    if (!edges[i].loop) continue;
    consistent[i] =
        !cycles.Joined(edges[i].from, edges[i].to) || cycles.OfOne(edges[i]) <= max_squared;
    if (consistent[i]) loops.push_back(i);
  }
  if (loops.size() > kMaxLoops) return consistent;

  std::vector<std::vector<bool>> agree(loops.size(), std::vector<bool>(loops.size(), true));
  std::vector<int> agreeing(loops.size(), 0);
  for (std::size_t a = 0; a < loops.size(); ++a) {
    for (std::size_t b = 0; b < a; ++b) {
      const PoseGraphEdge& first = edges[loops[a]];
      const PoseGraphEdge& second = edges[loops[b]];
      // Loops of other parts of the graph say nothing about each other.
      const bool same =
          cycles.Joined(first.from, second.from) && cycles.Joined(first.to, second.to);
      const bool agrees = !same || cycles.OfTwo(first, second) <= max_squared;
      agree[a][b] = agree[b][a] = agrees;
      agreeing[a] += agrees;
      agreeing[b] += agrees;
    }
  }
  std::vector<std::size_t> order(loops.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return agreeing[a] > agreeing[b]; });
  std::vector<std::size_t> clique;
  for (const std::size_t candidate : order) {
    const bool agrees_with_all = std::all_of(
        clique.begin(), clique.end(), [&](std::size_t other) { return agree[candidate][other]; });
    if (agrees_with_all) {
      clique.push_back(candidate);
    } else {
      consistent[loops[candidate]] = false;
    }
  }
  return consistent;
}

}  // namespace soundmap::mapping
