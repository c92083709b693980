#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "mapping/pose_graph.h"
#include "mapping/registration.h"

namespace soundmap::mapping {

// A sweep is cut into so many parts of equal time; the LIDAR's place is one for each.
inline constexpr int kSweepParts = 16;

// What the LRF saw through while a scan was taken: the ways from its place to each of these.
struct SeenThrough {
  Eigen::Vector3f laser_in_base = Eigen::Vector3f::Zero();
  std::vector<Eigen::Vector3f> to_in_base;
};

// A LIDAR scan that is kept for the map, straightened.
struct KeyScan {
  Eigen::Isometry3d map_from_base = Eigen::Isometry3d::Identity();
  std::vector<Eigen::Vector3f> point_in_base;  // one a voxel
  std::vector<std::uint8_t> part;              // of the sweep, for each point
  std::array<Eigen::Vector3f, kSweepParts> lidar_in_base;
  SeenThrough seen_through;  // nothing without an LRF
  // A surveyed pose, or the first of a map: stays where it is.
  bool fixed = false;
};

// The end of an edge that is the building to be extended, which stays where it is.
inline constexpr int kBuilding = -1;

// How well the pose of a scan is known, seen from another.
struct ScanUncertainty {
  double variance_m2 = 0.0;
  double variance_rad2 = 0.0;
  double way_m = 0.0;  // along the graph
  double std_m() const;
  // Of both, for surfaces some metres away; infinite where no edges lead.
  double combined_m() const;
};

// Key scans and what was measured between them.
class KeyScanGraph {
 public:
  std::vector<KeyScan> scans;
  std::vector<PoseGraphEdge> edges;  // between scans, or from kBuilding to one

  // Between two scans, or from kBuilding, as the poses are now.
  Eigen::Isometry3d Between(int from, int to) const;

  // Along the surest ways from one scan to all.
  std::vector<ScanUncertainty> UncertaintyFrom(int scan) const;

  // The first scan or the fixed ones and the building anchor it.
  absl::Status Optimize(PoseGraphReport* report = nullptr);

  // Takes in the scans and edges of another, its frame moved.
  void Append(KeyScanGraph&& other, const Eigen::Isometry3d& map_from_other);
};

// Of one drive, scan after scan, with the odometry; or of places seen again, without.
enum class EdgeKind { kDrive, kLoop };

// Information of an edge: what the registration says about it, for a drive what the odometry does,
// and how badly either may be off for reasons of its own.
Eigen::Matrix<double, 6, 6> EdgeInformation(
    const Eigen::Isometry3d& from_from_to,
    const Eigen::Matrix<double, 6, 6>& registration_information, EdgeKind kind);

// Trusted scans fit each other well enough to be taken for one rigid piece of the map.
bool Trusted(const ScanUncertainty& uncertainty);

// Points of scan `scan` and of trusted ones nearby, up to `radius_m` from it, in its base frame,
// thinned to `spacing_m`.
std::vector<Eigen::Vector3f> PointsAround(const KeyScanGraph& graph, int scan, double radius_m,
                                          int max_scans, double spacing_m);

}  // namespace soundmap::mapping
