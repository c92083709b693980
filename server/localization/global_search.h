#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "building/floor_plan.h"
#include "geometry/pose.h"
#include "localization/config.h"

namespace soundmap::localization {

struct Candidate {
  geometry::Pose2 map_from_base;
  double score = 0.0;  // mean over the points of exp(-d^2 / (2 field_std^2)), d to the nearest wall
};

// Where on the floor plan a cloud of beam ends fits: correlative matching against a field of the
// distance to the walls, by branch and bound on coarser fields (Olson, ICRA 2009; Hess et al., ICRA
// 2016). All free cells and all yaws come into question, one sector of the circle a call, so that
// the cost of a call is bounded. Immutable. Memory: 7 bytes a search cell, of which a plan has at
// most some 4 million.
class GlobalSearch {
 public:
  GlobalSearch(const SearchConfig& config, const building::FloorPlan& plan);

  // The best poses of base_link with a yaw in sector 0 .. sectors - 1, best first, each apart from
  // the better ones. Points farther than the configured range are left out.
  std::vector<Candidate> Search(std::span<const Eigen::Vector2d> points_in_base, int sector) const;

  // How far a candidate may lie from the pose that it stands for, along x or y.
  double tolerance_m() const { return cell_size_m_; }

  // Whether the plan has a cell that a robot can stand in.
  bool has_free_cell() const { return has_free_cell_; }

 private:
  struct Node;

  // Of the blocks of 2^level x 2^level cells that begin at each cell: the largest value of the
  // field.
  struct Level {
    std::vector<std::uint8_t> largest;
    std::vector<bool> any_free;  // of the blocks at multiples of 2^level, row by row
    int blocks_across = 0;
  };

  std::uint32_t Sum(const Level& level, std::span<const std::int32_t> offsets, int x, int y) const;

  SearchConfig config_;
  double cell_size_m_ = 0.0;
  double field_std_m_ = 0.0;
  Eigen::Vector2d corner_in_map_m_;  // of cell (0, 0) without the margin
  int margin_cells_ = 0;             // on every side, so that no point falls off the field
  int width_ = 0;                    // without the margin
  int height_ = 0;
  int stride_ = 0;
  bool has_free_cell_ = false;
  std::vector<Level> levels_;
};

}  // namespace soundmap::localization
