#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "geometry/pose.h"

namespace soundmap::mapping {

struct LaserWindow {
  double distance_m = 1.0;  // each of x and y, either way
  double angle_rad = 0.2;
  double max_point_distance_m = 20.0;  // further points take no part
};

struct LaserSearchResult {
  geometry::Pose2 map_from_base;
  double score = 0.0;  // mean over the points of how near they come to the map's, 0 to 1
  // No other place at least half a metre or 10 degrees away scores 90 % of that.
  bool unique = false;
};

// Finds where a scan fits a map best among all poses of a window, by branch and bound over a
// pyramid of grids (Hess et al. 2016, section V-B), so that nothing in the window is missed. Exact
// to the grid's cell.
class LaserSearch {
 public:
  LaserSearch(std::span<const Eigen::Vector2f> point_in_map, double cell_m);

  // None: nothing in the window scores `min_score`.
  std::optional<LaserSearchResult> Find(std::span<const Eigen::Vector2f> point_in_base,
                                        const geometry::Pose2& start_map_from_base,
                                        const LaserWindow& window, double min_score) const;

  // The best places, best first: each apart from the ones before, and with at least this share of
  // the first one's score.
  std::vector<LaserSearchResult> FindSeveral(std::span<const Eigen::Vector2f> point_in_base,
                                             const geometry::Pose2& start_map_from_base,
                                             const LaserWindow& window, double min_score,
                                             double min_share, int max_places) const;

 private:
  struct Candidate {
    int rotation = 0;
    int x = 0, y = 0;  // of the window's corner, cells from the start
    double score = 0.0;
  };
  struct Rotation {
    double yaw_rad = 0.0;
    std::vector<Eigen::Vector2i> cells;  // of the points, at the start's place
  };
  double Score(const Rotation& rotation, int x, int y, int level) const;
  std::vector<Candidate> Coarsest(const std::vector<Rotation>& rotations, int window_cells,
                                  double more_than, int& level) const;
  std::vector<Rotation> Rotations(std::span<const Eigen::Vector2f> point_in_base,
                                  const geometry::Pose2& start_map_from_base,
                                  const LaserWindow& window) const;
  bool Descend(const std::vector<Rotation>& rotations, std::vector<Candidate> candidates, int level,
               int window_cells, std::span<const Candidate> excluded, Candidate& best) const;

  float cell_m_;
  Eigen::Vector2i origin_;  // cell of the grid's corner
  int width_ = 0, height_ = 0;
  // Level l at (x, y): the largest of level 0 over 2^l x 2^l cells from there.
  std::vector<std::vector<std::uint8_t>> levels_;
};

}  // namespace soundmap::mapping
