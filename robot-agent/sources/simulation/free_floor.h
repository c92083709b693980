#pragma once

#include <Eigen/Core>
#include <vector>

#include "sources/simulation/scene.h"

namespace soundmap::simulation {

// Where something round can stand in a room with furniture, in cells of 10 cm. Of several places
// that are not joined only the largest counts.
class FreeFloor {
 public:
  FreeFloor(const Eigen::Vector3d& room_m, const std::vector<Box>& furniture, double radius_m);

  bool IsFree(const Eigen::Vector2d& point_in_map) const;
  double free_share() const;  // of the floor

  // Way points around what stands there, both ends included; empty where one of them is not free.
  std::vector<Eigen::Vector2d> ShortestPath(const Eigen::Vector2d& from,
                                            const Eigen::Vector2d& to) const;

 private:
  int CellOf(const Eigen::Vector2d& point_in_map) const;  // -1 outside
  Eigen::Vector2d CentreOf(int cell) const;
  bool IsLineFree(const Eigen::Vector2d& from, const Eigen::Vector2d& to) const;
  void KeepLargestPart();

  int columns_, rows_;
  std::vector<bool> free_;
};

}  // namespace soundmap::simulation
