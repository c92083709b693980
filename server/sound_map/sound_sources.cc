#include "sound_map/sound_sources.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <span>

#include "sound_map/clustering.h"
#include "sound_map/smoothing.h"
#include "sound_map/tile.h"

namespace soundmap::sound_map {
namespace {

// The voxels that speak for a source, L > 0, in map order.
struct PositiveVoxels {
  std::vector<geometry::VoxelKey> keys;
  std::vector<float> log_odds;
  std::vector<Support> support;

  int size() const { return static_cast<int>(keys.size()); }
};

struct Cluster {
  Eigen::Vector3d position_in_map_m = Eigen::Vector3d::Zero();
  double probability = 0.0;
  std::vector<int> voxels;  // ascending
};

PositiveVoxels FindPositiveVoxels(const Snapshot& snapshot, const SoundSourceConfig& config) {
  PositiveVoxels positive;
  for (const auto& tile : snapshot.tiles()) {
    const SupportTable& support = tile->support();
    tile->ForEach([&](const geometry::VoxelKey& key, const Voxel& voxel) {
      if (voxel.log_odds <= 0.0f || voxel.update_count <= config.min_updates) return true;
      const auto heard = support.find(static_cast<std::uint16_t>(
          Tile::BlockOf(key) * Block::kVoxels + Tile::VoxelOf(key)));
      positive.keys.push_back(key);
      positive.log_odds.push_back(voxel.log_odds);
      positive.support.push_back(heard == support.end() ? Support{} : heard->second);
      return true;
    });
  }
  if (positive.size() <= config.max_voxels) return positive;

  std::vector<int> order(positive.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return positive.log_odds[a] > positive.log_odds[b]; });
  order.resize(config.max_voxels);
  std::sort(order.begin(), order.end());
  PositiveVoxels kept;
  for (const int i : order) {
    kept.keys.push_back(positive.keys[i]);
    kept.log_odds.push_back(positive.log_odds[i]);
    kept.support.push_back(positive.support[i]);
  }
  return kept;
}

std::vector<Cluster> KMeansClusters(const PositiveVoxels& positive, double voxel_size_m,
                                    const SoundSourceConfig& config) {
  std::vector<LocalMaximum> maxima = FindLocalMaxima(positive.keys, positive.log_odds);
  std::stable_sort(maxima.begin(), maxima.end(),
                   [](const auto& a, const auto& b) { return a.value > b.value; });
  if (maxima.size() > static_cast<std::size_t>(config.max_seeds)) maxima.resize(config.max_seeds);

  const auto point_from = [&](const Eigen::Vector3d& key) -> Eigen::Vector3d {
    return (key + Eigen::Vector3d::Constant(0.5 - geometry::VoxelKey::kCentre)) * voxel_size_m;
  };
  std::vector<Eigen::Vector3d> seeds;
  for (const LocalMaximum& maximum : maxima) seeds.push_back(point_from(maximum.centroid_key));
  std::vector<Eigen::Vector3d> points;
  for (const auto& key : positive.keys) {
    points.push_back(geometry::PointFromKey(key, voxel_size_m));
  }
  const KMeansResult result = KMeans(points, std::move(seeds), config.max_iterations);

  std::vector<Cluster> clusters(result.centres.size());
  for (int i = 0; i < positive.size(); ++i) {
    clusters[result.cluster_of_point[i]].voxels.push_back(i);
  }
  for (std::size_t c = 0; c < clusters.size(); ++c) {
    clusters[c].position_in_map_m = result.centres[c];
    for (const int i : clusters[c].voxels) {
      clusters[c].probability =
          std::max(clusters[c].probability, ProbabilityFromLogOdds(positive.log_odds[i]));
    }
  }
  return clusters;
}

std::vector<Cluster> SmoothPeakClusters(const Snapshot& snapshot, const PositiveVoxels& positive,
                                        const SoundSourceConfig& config) {
  const double voxel_size_m = snapshot.voxel_size_m();
  const std::vector<float> smooth =
      SmoothLogOdds(snapshot, positive.keys, config.smoothing_sigma_m / voxel_size_m);
  std::vector<int> order(positive.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return smooth[a] > smooth[b]; });

  std::vector<Eigen::Vector3d> points;
  for (const auto& key : positive.keys) {
    points.push_back(geometry::PointFromKey(key, voxel_size_m));
  }
  std::vector<Eigen::Vector3d> peaks;
  std::vector<Cluster> clusters;
  for (const int top : order) {
    if (smooth[top] <= 0.0f || peaks.size() >= static_cast<std::size_t>(config.max_seeds)) break;
    const bool taken = std::any_of(peaks.begin(), peaks.end(), [&](const Eigen::Vector3d& peak) {
      return (peak - points[top]).norm() < config.separation_m;
    });
    if (taken) continue;
    peaks.push_back(points[top]);
    Cluster& cluster = clusters.emplace_back();
    cluster.probability = ProbabilityFromLogOdds(smooth[top]);
  }

  for (int i = 0; i < positive.size(); ++i) {
    int nearest = -1;
    double nearest_m = config.core_radius_m;
    for (std::size_t c = 0; c < peaks.size(); ++c) {
      const double distance_m = (peaks[c] - points[i]).norm();
      if (distance_m >= nearest_m) continue;
      nearest = static_cast<int>(c);
      nearest_m = distance_m;
    }
    if (nearest >= 0) clusters[nearest].voxels.push_back(i);
  }
  for (Cluster& cluster : clusters) {
    double weight = 0.0;
    std::uint64_t evidence = 0;
    for (const int i : cluster.voxels) {
      cluster.position_in_map_m += positive.log_odds[i] * points[i];
      weight += positive.log_odds[i];
      evidence += positive.support[i].count;
    }
    cluster.position_in_map_m /= weight;
    if (evidence < config.min_evidence) cluster.voxels.clear();
  }
  return clusters;
}

std::uint64_t Mix(std::uint64_t hash, std::uint64_t value) {
  hash = (hash ^ value) * 0xff51afd7ed558ccdu;
  return hash ^ (hash >> 32);
}

SoundSource Describe(const Cluster& cluster, const PositiveVoxels& positive, double voxel_size_m) {
  SoundSource source;
  source.position_in_map_m = cluster.position_in_map_m;
  source.probability = cluster.probability;
  source.voxel_count = static_cast<int>(cluster.voxels.size());
  double weight = 0.0;
  double spread_m2 = 0.0;
  const geometry::VoxelKey* first_key = &positive.keys[cluster.voxels.front()];
  bool heard = false;
  for (const int i : cluster.voxels) {
    const double log_odds = positive.log_odds[i];
    weight += log_odds;
    spread_m2 += log_odds * (geometry::PointFromKey(positive.keys[i], voxel_size_m) -
                             cluster.position_in_map_m)
                                .squaredNorm();
    source.peak_log_odds = std::max(source.peak_log_odds, positive.log_odds[i]);
    const Support& support = positive.support[i];
    if (support.count == 0) continue;
    source.evidence_count += support.count;
    if (!heard || support.first_heard_ns < source.first_heard_ns) {
      source.first_heard_ns = support.first_heard_ns;
      first_key = &positive.keys[i];
    }
    source.last_heard_ns =
        heard ? std::max(source.last_heard_ns, support.last_heard_ns) : support.last_heard_ns;
    heard = true;
  }
  // A square of edge a has the mean squared distance a^2 / 6 from its centre; a single voxel is as wide as itself.
  source.extent_m = std::max(std::sqrt(6.0 * spread_m2 / weight), voxel_size_m);
  source.id = Mix(Mix(0x736f756e646d6170u, static_cast<std::uint64_t>(source.first_heard_ns)),
                  std::hash<geometry::VoxelKey>()(*first_key));
  return source;
}

}  // namespace

std::vector<SoundSource> FindSoundSources(const Snapshot& snapshot,
                                          const SoundSourceConfig& config) {
  const PositiveVoxels positive = FindPositiveVoxels(snapshot, config);
  const std::vector<Cluster> clusters =
      config.method == SourceMethod::kKMeans
          ? KMeansClusters(positive, snapshot.voxel_size_m(), config)
          : SmoothPeakClusters(snapshot, positive, config);
  std::vector<SoundSource> sources;
  for (const Cluster& cluster : clusters) {
    if (cluster.voxels.empty()) continue;
    sources.push_back(Describe(cluster, positive, snapshot.voxel_size_m()));
  }
  std::sort(sources.begin(), sources.end(), [](const SoundSource& a, const SoundSource& b) {
    return a.probability != b.probability ? a.probability > b.probability : a.id < b.id;
  });
  if (sources.size() > static_cast<std::size_t>(config.max_sources)) {
    sources.resize(config.max_sources);
  }
  return sources;
}

}  // namespace soundmap::sound_map
