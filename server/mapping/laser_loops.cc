#include "mapping/laser_loops.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "mapping/laser_lines.h"
#include "mapping/laser_matching.h"
#include "mapping/laser_search.h"
#include "mapping/planar_poses.h"
#include "mapping/pose_graph.h"
#include "mapping/surveyed_poses.h"

namespace soundmap::mapping {
namespace {

using geometry::Pose2;

// Stretches this close in the drive have been aligned to each other already.
constexpr int kNeighbours = 3;
constexpr int kMaxCandidates = 8;
// From a place, walls are seen again from another this far away.
constexpr double kReach_m = 6.0;
constexpr double kSearchCell_m = 0.1;
// Of the walls of a map that exists, those this near are compared with.
constexpr float kMapAround_m = 25.0f;
constexpr float kGroupPoints_m = 0.1f;
constexpr double kWayPerWindow = 2.0;
constexpr int kMaxMoreStretches = 3;
constexpr double kAngleWindow_rad = 0.1;
constexpr double kAngleWindowPerMetre_rad = 0.005;
constexpr double kMaxAngleWindow_rad = 0.6;

constexpr double kMinScore = 0.6;
constexpr double kMinOverlap = 0.6;
constexpr double kMinFit = 0.7;
constexpr int kMinInliers = 60;
// The 99.9 % quantile of chi-squared for 3 degrees of freedom.
constexpr double kMaxSurprise = 16.3;
// Of a loop, however well it fits: the stretches are not rigid.
constexpr double kLoopStd_m = 0.03;
constexpr double kLoopStd_rad = 0.005;

// How an error at a pose, in its axes, shows at another one that is rigidly tied to it.
Eigen::Matrix3d Carried(const Pose2& here_from_there) {
  Eigen::Matrix3d there = Eigen::Matrix3d::Identity();
  const Eigen::Matrix2d there_from_here =
      Eigen::Rotation2Dd(-here_from_there.yaw_rad).toRotationMatrix();
  there.topLeftCorner<2, 2>() = there_from_here;
  there.topRightCorner<2, 1>() =
      there_from_here * Eigen::Vector2d(-here_from_there.y_m, here_from_there.x_m);
  return there;
}

Eigen::Matrix<double, 6, 6> InSpace(const Eigen::Matrix3d& information) {
  const int index[3] = {0, 1, 5};
  Eigen::Matrix<double, 6, 6> in_space = Eigen::Matrix<double, 6, 6>::Zero();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      in_space(index[row], index[column]) =
          0.5 * (information(row, column) + information(column, row));
    }
  }
  return in_space;
}

void Append(const Pose2& map_from_points, const std::vector<Eigen::Vector2f>& points,
            std::vector<Eigen::Vector2f>& point_in_map) {
  const Eigen::Isometry2f transform = InPlane(map_from_points);
  for (const Eigen::Vector2f& point : points) point_in_map.push_back(transform * point);
}

class LoopCloser {
 public:
  LoopCloser(const FloorPlanMapperConfig& config, std::vector<LaserKeyScan>& key_scans)
      : config_(config), key_scans_(key_scans) {
    for (std::size_t i = 0; i < key_scans_.size(); ++i) {
      by_front_end_.push_back(key_scans_[i].map_from_base);
      if (i == 0 || key_scans_[i].begins_drive ||
          key_scans_[i].way_m - key_scans_[first_.back()].way_m >= config_.stretch_m) {
        first_.push_back(i);
      }
    }
  }

  absl::Status Run(const std::function<bool(double)>& progress, LoopReport& report);

 private:
  struct Candidate {
    int stretch = 0;
    double way_m = 0.0;  // there
    Eigen::Matrix3d covariance;
  };

  bool IsMap(int stretch) const { return stretch == 0 && key_scans_.front().is_map; }
  int stretches() const { return static_cast<int>(first_.size()); }
  std::size_t End(int stretch) const {
    return stretch + 1 < stretches() ? first_[stretch + 1] : key_scans_.size();
  }
  void AddChainEdge(int from);
  std::vector<double> WayThroughGraph(int from, std::vector<int>& through) const;
  Eigen::Matrix3d CovarianceOf(int stretch, int other, const std::vector<int>& through) const;
  std::vector<Candidate> Candidates(int stretch) const;
  bool Match(const Candidate& candidate, int later);
  absl::Status Optimize(LoopReport& report);
  void PlaceKeyScans();

  const FloorPlanMapperConfig& config_;
  std::vector<LaserKeyScan>& key_scans_;
  std::vector<Pose2> by_front_end_;
  std::vector<std::size_t> first_;                  // key scan of each stretch, its anchor
  std::vector<Eigen::Isometry3d> map_from_anchor_;  // of the stretches so far
  std::vector<PoseGraphEdge> edges_;
  std::vector<Eigen::Matrix3d> covariance_;  // of the edges
};

void LoopCloser::AddChainEdge(int from) {
  const std::size_t end = first_[from + 1];
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (std::size_t i = first_[from] + 1; i <= end; ++i) {
    const Eigen::Matrix3d carried = Carried(by_front_end_[i].Inverse() * by_front_end_[end]);
    covariance += carried * key_scans_[i].step_covariance * carried.transpose();
  }
  PoseGraphEdge edge;
  edge.from = from;
  edge.to = from + 1;
  edge.from_from_to = (by_front_end_[first_[from]].Inverse() * by_front_end_[end]).ToIsometry();
  edge.information = InSpace(covariance.inverse());
  edges_.push_back(edge);
  covariance_.push_back(covariance);
  map_from_anchor_.push_back(map_from_anchor_.back() * edge.from_from_to);
}

// The shortest way from one stretch to each along the drive and over loops: along it errors gather.
// `through`: the last edge of the way to each.
std::vector<double> LoopCloser::WayThroughGraph(int from, std::vector<int>& through) const {
  std::vector<double> way_m(map_from_anchor_.size(), std::numeric_limits<double>::infinity());
  through.assign(map_from_anchor_.size(), -1);
  way_m[from] = 0.0;
  for (bool changed = true; changed;) {
    changed = false;
    for (std::size_t i = 0; i < edges_.size(); ++i) {
      const PoseGraphEdge& edge = edges_[i];
      const double length_m =
          edge.loop ? 0.0 : key_scans_[first_[edge.to]].way_m - key_scans_[first_[edge.from]].way_m;
      for (const auto& [a, b] : {std::pair(edge.from, edge.to), std::pair(edge.to, edge.from)}) {
        if (way_m[a] + length_m < way_m[b]) {
          way_m[b] = way_m[a] + length_m;
          through[b] = static_cast<int>(i);
          changed = true;
        }
      }
    }
  }
  return way_m;
}

// Of the pose of a stretch as seen from another, in the axes of the former: what gathers on the
// way.
Eigen::Matrix3d LoopCloser::CovarianceOf(int stretch, int other,
                                         const std::vector<int>& through) const {
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (int at = other; at != stretch;) {
    const PoseGraphEdge& edge = edges_[through[at]];
    const Eigen::Matrix3d carried = Carried(
        geometry::ProjectToFloor(map_from_anchor_[edge.to].inverse() * map_from_anchor_[stretch]));
    covariance += carried * covariance_[through[at]] * carried.transpose();
    at = edge.from == at ? edge.to : edge.from;
  }
  return covariance;
}

// Earlier stretches that may be at the same place, nearest first.
std::vector<LoopCloser::Candidate> LoopCloser::Candidates(int stretch) const {
  std::vector<int> through;
  const std::vector<double> way_m = WayThroughGraph(stretch, through);
  std::vector<std::pair<double, int>> near;
  if (key_scans_.front().is_map) near.emplace_back(0.0, 0);
  for (int other = static_cast<int>(near.size()); other + kNeighbours <= stretch; ++other) {
    const double distance_m =
        (map_from_anchor_[other].translation() - map_from_anchor_[stretch].translation()).norm();
    const double search_m =
        std::min(config_.loop_search_m + config_.loop_search_per_m * way_m[other],
                 config_.max_loop_search_m);
    if (distance_m <= search_m + kReach_m) near.emplace_back(distance_m, other);
  }
  std::sort(near.begin(), near.end());
  if (near.size() > kMaxCandidates) near.resize(kMaxCandidates);
  std::vector<Candidate> candidates;
  candidates.reserve(near.size());
  for (const auto& [distance_m, other] : near) {
    candidates.push_back({other, way_m[other], CovarianceOf(stretch, other, through)});
  }
  return candidates;
}

bool LoopCloser::Match(const Candidate& candidate, int later) {
  const int earlier = candidate.stretch;
  const double way_m = candidate.way_m;
  LaserWindow window;
  window.distance_m = std::min(config_.loop_search_m + config_.loop_search_per_m * way_m,
                               config_.max_loop_search_m);
  window.angle_rad =
      std::min(kAngleWindow_rad + kAngleWindowPerMetre_rad * way_m, kMaxAngleWindow_rad);
  // The wider the search, the more of the way must fit: a short stretch finds its like elsewhere.
  int more = std::min(static_cast<int>(kWayPerWindow * window.distance_m / config_.stretch_m),
                      kMaxMoreStretches);
  if (!IsMap(earlier)) more = std::min(more, later - earlier - kNeighbours);
  for (int before = 0; before < more; ++before) {
    if (key_scans_[first_[later - before]].begins_drive) more = before;
  }
  std::vector<Eigen::Vector2f> map;
  const Pose2 start = geometry::ProjectToFloor(map_from_anchor_[later]);
  if (IsMap(earlier)) {
    const Eigen::Vector2f there(static_cast<float>(start.x_m), static_cast<float>(start.y_m));
    for (const Eigen::Vector2f& point : key_scans_.front().points.point_in_base) {
      if ((point - there).cwiseAbs().maxCoeff() <= kMapAround_m) map.push_back(point);
    }
  } else {
    const int from = std::max(earlier - 1 - more, key_scans_.front().is_map ? 1 : 0);
    const int to = std::min(earlier + 1 + more, later - more - 2);
    for (std::size_t i = first_[from]; i < End(to); ++i) {
      Append(key_scans_[i].map_from_base, key_scans_[i].points.point_in_base, map);
    }
  }
  if (map.empty()) return false;
  LineMap lines(config_.wall_piece_m);
  lines.Insert(map);
  lines.FitLines();

  std::vector<Eigen::Vector2f> in_anchor;
  const Pose2 anchor_from_front_end = by_front_end_[first_[later]].Inverse();
  for (std::size_t i = first_[later - more]; i < End(later); ++i) {
    Append(anchor_from_front_end * by_front_end_[i], key_scans_[i].point_to_match, in_anchor);
  }
  in_anchor = FirstPointPerSquare(in_anchor, kGroupPoints_m);

  const LaserSearch search(map, kSearchCell_m);
  const auto found = search.Find(in_anchor, start, window, kMinScore);
  if (!found) return false;
  const LaserMatch match =
      MatchToLines(in_anchor, lines, found->map_from_base,
                   {.start_distance_m = 0.3, .prior_std_m = 0.3, .prior_std_rad = 0.05});
  const Eigen::Matrix3d floor =
      Eigen::Vector3d(kLoopStd_m * kLoopStd_m, kLoopStd_m * kLoopStd_m, kLoopStd_rad * kLoopStd_rad)
          .asDiagonal();
  const Eigen::Matrix3d tiny = 1e-6 * Eigen::Matrix3d::Identity();
  const Eigen::Matrix3d covariance = (match.information + tiny).inverse() + floor;
  // Is it where the way there allows it to be?
  const Pose2 off = start.Inverse() * match.map_from_base;
  const Eigen::Vector3d off_by(off.x_m, off.y_m, off.yaw_rad);
  const double surprise = off_by.dot((candidate.covariance + covariance).inverse() * off_by);
  const bool good = surprise <= kMaxSurprise && found->unique && match.overlap() >= kMinOverlap &&
                    match.fit() >= kMinFit && match.inliers >= kMinInliers;
  if (!good) return false;
  PoseGraphEdge edge;
  edge.from = earlier;
  edge.to = later;
  edge.from_from_to = map_from_anchor_[earlier].inverse() * match.map_from_base.ToIsometry();
  edge.information = InSpace(covariance.inverse());
  edge.loop = true;
  edges_.push_back(edge);
  covariance_.push_back(covariance);
  return true;
}

// Key scans between two anchors move as the front end says, and what is left at the second is
// spread over them.
void LoopCloser::PlaceKeyScans() {
  for (int stretch = 0; stretch < static_cast<int>(map_from_anchor_.size()); ++stretch) {
    const std::size_t begin = first_[stretch], end = End(stretch);
    const Pose2 map_from_begin = geometry::ProjectToFloor(map_from_anchor_[stretch]);
    const bool last =
        stretch + 1 == static_cast<int>(map_from_anchor_.size()) || key_scans_[end].begins_drive;
    for (std::size_t i = begin; i < end; ++i) {
      key_scans_[i].map_from_base =
          last ? map_from_begin * by_front_end_[begin].Inverse() * by_front_end_[i]
               : Between(map_from_begin, by_front_end_[begin],
                         geometry::ProjectToFloor(map_from_anchor_[stretch + 1]),
                         by_front_end_[end], by_front_end_[i],
                         static_cast<double>(i - begin) / static_cast<double>(end - begin));
    }
  }
}

absl::Status LoopCloser::Optimize(LoopReport& report) {
  PoseGraphReport graph;
  const int anchor = 0;
  const absl::Status status =
      OptimizePoseGraph(edges_, {&anchor, 1}, /*planar=*/true, {}, map_from_anchor_, &graph);
  if (!status.ok()) return status;
  report.loops_refused = graph.loops_refused;
  PlaceKeyScans();
  return absl::OkStatus();
}

absl::Status LoopCloser::Run(const std::function<bool(double)>& progress, LoopReport& report) {
  if (key_scans_.empty()) return absl::OkStatus();
  map_from_anchor_.push_back(by_front_end_.front().ToIsometry());
  for (int stretch = 1; stretch < stretches(); ++stretch) {
    AddChainEdge(stretch - 1);
    PlaceKeyScans();
    bool found = false;
    for (const Candidate& candidate : Candidates(stretch)) {
      if (!Match(candidate, stretch)) continue;
      found = true;
      ++report.loops_closed;
    }
    if (found) {
      const absl::Status status = Optimize(report);
      if (!status.ok()) return status;
    }
    if (progress && !progress(static_cast<double>(stretch + 1) / stretches())) {
      return absl::CancelledError("the mapping was cancelled");
    }
  }
  report.loops_closed -= report.loops_refused;
  return absl::OkStatus();
}

}  // namespace

absl::Status CloseLoops(const FloorPlanMapperConfig& config,
                        const std::function<bool(double)>& progress,
                        std::vector<LaserKeyScan>& key_scans, LoopReport& report) {
  return LoopCloser(config, key_scans).Run(progress, report);
}

}  // namespace soundmap::mapping
