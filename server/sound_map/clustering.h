#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "geometry/voxel_key.h"

namespace soundmap::sound_map {

// A local maximum over 26 neighbours: a connected set of voxels of one value (a plateau; mostly one
// voxel) without a greater neighbour.
struct LocalMaximum {
  Eigen::Vector3d centroid_key = Eigen::Vector3d::Zero();  // mean of the voxels' keys
  float value = 0.0f;
  int first_voxel = 0;  // the lowest index of its voxels
};

// The local maxima of the values over the voxels, no voxel twice; a voxel that is not given is no
// neighbour. In the order of `first_voxel`.
std::vector<LocalMaximum> FindLocalMaxima(std::span<const geometry::VoxelKey> keys,
                                          std::span<const float> values);

struct KMeansResult {
  std::vector<Eigen::Vector3d>
      centres;                        // one a seed; a cluster that lost its points keeps its centre
  std::vector<int> cluster_of_point;  // the nearest centre; of two at one distance the lower
  int iterations = 0;
};

// Lloyd's algorithm until no point changes its cluster.
KMeansResult KMeans(std::span<const Eigen::Vector3d> points, std::vector<Eigen::Vector3d> seeds,
                    int max_iterations);

}  // namespace soundmap::sound_map
