#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <span>
#include <vector>

#include "mapping/key_scan_graph.h"
#include "mapping/pose_search.h"
#include "mapping/registration.h"

namespace soundmap::mapping {

struct LoopCount {
  int tried = 0;
  int closed = 0;
  // Found, but the pose graph says that they contradict what else is known.
  int refused = 0;
};

// Finds where scans lie on a piece of the map, judged by the surfaces alone.
class PlaceVerifier {
 public:
  // With the map's surfaces at its finest and two coarser levels.
  explicit PlaceVerifier(const SurfacePyramid& map) : map_(map), search_(map.levels().front()) {}

  // The place of these points in the window if one fits and no other does nearly as well. A place
  // fits when the points lie on the map's surfaces, and those of the map around it are seen in the
  // points, too. Places that differ only along a direction which the surfaces leave open, as along
  // a bare corridor, are one.
  std::optional<Registration> Find(std::span<const Eigen::Vector3f> point_in_base,
                                   const SearchWindow& window) const;

  // All places that fit, best first.
  std::vector<Registration> FindAll(std::span<const Eigen::Vector3f> point_in_base,
                                    const SearchWindow& window) const;

  // The fit near a pose that is known to about half a metre.
  std::optional<Registration> FindNear(std::span<const Eigen::Vector3f> point_in_base,
                                       const Eigen::Isometry3d& map_from_base) const;

  SearchWindow Everywhere() const { return search_.Everywhere(); }

 private:
  bool Fits(std::span<const Eigen::Vector3f> point_in_base, const Registration& found) const;

  const SurfacePyramid& map_;
  PoseSearch search_;
};

// The robot may have come back at this scan to where it was long ago: looks for the nearest scan to
// which it is not yet trusted, within the uncertainty between them, and adds an edge where that
// verifies and agrees with the rest of the graph, whose poses then follow. True if they did.
bool CloseLoop(KeyScanGraph& graph, int scan, double surface_voxel_size_m, LoopCount& count);

}  // namespace soundmap::mapping
