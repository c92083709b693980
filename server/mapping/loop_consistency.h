#pragma once

#include <span>
#include <vector>

#include "mapping/pose_graph.h"

namespace soundmap::mapping {

// Which of the edges that are loops agree with the chain of the other edges, as far as that can err
// by its information, and with each other (pairwise consistent measurements, Mangelson et al. 2018;
// the clique is found greedily). `max_squared` bounds the squared Mahalanobis distance of a cycle.
// Loops that join what the chain leaves apart are judged by each other alone. True for edges that
// are no loops. The edges must be sound: indices in range, finite.
std::vector<bool> ConsistentLoops(std::span<const PoseGraphEdge> edges, int nodes, bool planar,
                                  double max_squared);

}  // namespace soundmap::mapping
