#include "sound_map/clustering.h"

#include <algorithm>
#include <boost/unordered/unordered_flat_map.hpp>
#include <limits>
#include <numeric>
#include <optional>

namespace soundmap::sound_map {
namespace {

std::optional<geometry::VoxelKey> Neighbour(const geometry::VoxelKey& key, int dx, int dy, int dz) {
  const int x = key.x + dx;
  const int y = key.y + dy;
  const int z = key.z + dz;
  if (std::min({x, y, z}) < 0 || std::max({x, y, z}) > 65535) return std::nullopt;
  return geometry::VoxelKey{static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y),
                            static_cast<std::uint16_t>(z)};
}

// The nearest of many centres: they stand in the order of x, and the search goes outwards from the
// point's x until x alone is too far.
class NearestCentre {
 public:
  explicit NearestCentre(std::span<const Eigen::Vector3d> centres) : order_(centres.size()) {
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.end(),
                     [&](int a, int b) { return centres[a].x() < centres[b].x(); });
    for (const int index : order_) sorted_.push_back(centres[index]);
  }

  int operator()(const Eigen::Vector3d& point) const {
    const auto split =
        std::lower_bound(sorted_.begin(), sorted_.end(), point.x(),
                         [](const Eigen::Vector3d& centre, double x) { return centre.x() < x; });
    const int size = static_cast<int>(sorted_.size());
    int right = static_cast<int>(split - sorted_.begin());
    int left = right - 1;
    double best = std::numeric_limits<double>::infinity();
    int best_index = 0;
    const auto consider = [&](int i) {
      const double distance = (sorted_[i] - point).squaredNorm();
      if (distance < best || (distance == best && order_[i] < best_index)) {
        best = distance;
        best_index = order_[i];
      }
    };
    const auto x_distance = [&](int i) {
      const double dx = sorted_[i].x() - point.x();
      return dx * dx;
    };
    while (true) {
      const bool go_right = right < size && x_distance(right) <= best;
      const bool go_left = left >= 0 && x_distance(left) <= best;
      if (!go_right && !go_left) return best_index;
      if (go_right) consider(right++);
      if (go_left) consider(left--);
    }
  }

 private:
  std::vector<int> order_;
  std::vector<Eigen::Vector3d> sorted_;
};

}  // namespace

std::vector<LocalMaximum> FindLocalMaxima(std::span<const geometry::VoxelKey> keys,
                                          std::span<const float> values) {
  boost::unordered_flat_map<geometry::VoxelKey, int, std::hash<geometry::VoxelKey>> index_of;
  index_of.reserve(keys.size());
  for (std::size_t i = 0; i < keys.size(); ++i) index_of.emplace(keys[i], static_cast<int>(i));

  std::vector<LocalMaximum> maxima;
  std::vector<char> seen(keys.size(), 0);
  std::vector<int> plateau;
  for (std::size_t start = 0; start < keys.size(); ++start) {
    if (seen[start] != 0) continue;
    seen[start] = 1;
    plateau.assign(1, static_cast<int>(start));
    bool is_maximum = true;
    for (std::size_t next = 0; next < plateau.size(); ++next) {
      const int voxel = plateau[next];
      for (int offset = 0; offset < 27; ++offset) {
        if (offset == 13) continue;
        const auto key = Neighbour(keys[voxel], offset % 3 - 1, offset / 3 % 3 - 1, offset / 9 - 1);
        const auto found = key ? index_of.find(*key) : index_of.end();
        if (found == index_of.end()) continue;
        const int neighbour = found->second;
        if (values[neighbour] > values[voxel]) is_maximum = false;
        if (values[neighbour] == values[voxel] && seen[neighbour] == 0) {
          seen[neighbour] = 1;
          plateau.push_back(neighbour);
        }
      }
    }
    if (!is_maximum) continue;
    LocalMaximum& maximum = maxima.emplace_back();
    maximum.value = values[start];
    maximum.first_voxel = static_cast<int>(start);
    std::sort(plateau.begin(), plateau.end());
    for (const int voxel : plateau) {
      maximum.centroid_key += Eigen::Vector3d(keys[voxel].x, keys[voxel].y, keys[voxel].z);
    }
    maximum.centroid_key /= static_cast<double>(plateau.size());
  }
  return maxima;
}

KMeansResult KMeans(std::span<const Eigen::Vector3d> points, std::vector<Eigen::Vector3d> seeds,
                    int max_iterations) {
  KMeansResult result;
  result.centres = std::move(seeds);
  result.cluster_of_point.assign(points.size(), -1);
  if (result.centres.empty()) return result;
  for (bool changed = true; changed && result.iterations < max_iterations; ++result.iterations) {
    changed = false;
    const NearestCentre nearest(result.centres);
    std::vector<Eigen::Vector3d> sums(result.centres.size(), Eigen::Vector3d::Zero());
    std::vector<int> counts(result.centres.size(), 0);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const int cluster = nearest(points[i]);
      changed |= cluster != result.cluster_of_point[i];
      result.cluster_of_point[i] = cluster;
      sums[cluster] += points[i];
      ++counts[cluster];
    }
    for (std::size_t c = 0; c < sums.size(); ++c) {
      if (counts[c] != 0) result.centres[c] = sums[c] / counts[c];
    }
  }
  return result;
}

}  // namespace soundmap::sound_map
