#include "sound_map/sound_sources.h"

#include <algorithm>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cmath>
#include <numeric>
#include <optional>

#include "sound_map/clustering.h"
#include "sound_map/tile.h"

namespace soundmap::sound_map {
namespace {

// At most `limit` of the voxels, those of the largest rank, in the order in which they stood.
template <typename Rank>
void KeepLargest(std::vector<ObservedVoxel>& voxels, int limit, Rank rank) {
  if (voxels.size() <= static_cast<std::size_t>(limit)) return;
  std::vector<int> order(voxels.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return rank(voxels[a]) > rank(voxels[b]); });
  order.resize(limit);
  std::sort(order.begin(), order.end());
  std::vector<ObservedVoxel> kept;
  kept.reserve(order.size());
  for (const int i : order) kept.push_back(voxels[i]);
  voxels = std::move(kept);
}

Eigen::Vector3d CentreOf(const ObservedVoxel& voxel, double voxel_size_m) {
  return geometry::PointFromKey(voxel.key, voxel_size_m);
}

std::uint64_t Mix(std::uint64_t hash, std::uint64_t value) {
  hash = (hash ^ value) * 0xff51afd7ed558ccdu;
  return hash ^ (hash >> 32);
}

// All but position and probability, from voxels that carry these weights. There must be a voxel,
// and a weight above 0.
void Describe(const std::vector<const ObservedVoxel*>& voxels, const std::vector<double>& weights,
              double voxel_size_m, SoundSource& source) {
  source.voxel_count = static_cast<int>(voxels.size());
  double weight_sum = 0.0;
  double spread_m2 = 0.0;
  const ObservedVoxel* first = nullptr;
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    const ObservedVoxel& voxel = *voxels[i];
    weight_sum += weights[i];
    spread_m2 +=
        weights[i] * (CentreOf(voxel, voxel_size_m) - source.position_in_map_m).squaredNorm();
    source.peak_log_odds =
        i == 0 ? voxel.fields.log_odds : std::max(source.peak_log_odds, voxel.fields.log_odds);
    if (voxel.support.count == 0) continue;
    source.evidence_count += voxel.support.count;
    source.last_heard_ns = first == nullptr
                               ? voxel.support.last_heard_ns
                               : std::max(source.last_heard_ns, voxel.support.last_heard_ns);
    if (first == nullptr || voxel.support.first_heard_ns < first->support.first_heard_ns ||
        (voxel.support.first_heard_ns == first->support.first_heard_ns && voxel.key < first->key)) {
      first = &voxel;
    }
  }
  if (first == nullptr) first = voxels.front();
  source.first_heard_ns = first->support.first_heard_ns;
  // A square of edge a has the mean squared distance a^2 / 6 from its centre; a single voxel is as
  // wide as itself.
  source.extent_m = std::max(std::sqrt(6.0 * spread_m2 / weight_sum), voxel_size_m);
  source.id = Mix(Mix(0x736f756e646d6170u, static_cast<std::uint64_t>(source.first_heard_ns)),
                  std::hash<geometry::VoxelKey>()(first->key));
}

std::vector<SoundSource> FindByKMeans(const Snapshot& snapshot, const SoundSourceConfig& config) {
  std::vector<ObservedVoxel> positive;
  for (const auto& tile : snapshot.tiles()) {
    tile->ForEach([&](const geometry::VoxelKey& key, const Voxel& voxel) {
      if (voxel.log_odds <= 0.0f || voxel.update_count <= config.min_updates) return true;
      const auto heard = tile->support().find(
          static_cast<std::uint16_t>(Tile::BlockOf(key) * Block::kVoxels + Tile::VoxelOf(key)));
      positive.push_back({key, voxel, heard == tile->support().end() ? Support{} : heard->second});
      return true;
    });
  }
  KeepLargest(positive, config.max_voxels,
              [](const ObservedVoxel& voxel) { return voxel.fields.log_odds; });

  const double voxel_size_m = snapshot.voxel_size_m();
  std::vector<geometry::VoxelKey> keys;
  std::vector<float> log_odds;
  std::vector<Eigen::Vector3d> points;
  for (const ObservedVoxel& voxel : positive) {
    keys.push_back(voxel.key);
    log_odds.push_back(voxel.fields.log_odds);
    points.push_back(CentreOf(voxel, voxel_size_m));
  }
  std::vector<LocalMaximum> maxima = FindLocalMaxima(keys, log_odds);
  std::stable_sort(maxima.begin(), maxima.end(),
                   [](const auto& a, const auto& b) { return a.value > b.value; });
  if (maxima.size() > static_cast<std::size_t>(config.max_seeds)) maxima.resize(config.max_seeds);
  std::vector<Eigen::Vector3d> seeds;
  seeds.reserve(maxima.size());
  for (const LocalMaximum& maximum : maxima) {
    seeds.push_back(
        (maximum.centroid_key + Eigen::Vector3d::Constant(0.5 - geometry::VoxelKey::kCentre)) *
        voxel_size_m);
  }
  // Bounded, since a search comes again with every update of the sources.
  constexpr std::size_t kMaxSteps = 1'000'000;
  const int max_iterations = static_cast<int>(std::clamp<std::size_t>(
      kMaxSteps / std::max<std::size_t>(points.size(), 1), 1, config.max_iterations));
  const KMeansResult clusters = KMeans(points, std::move(seeds), max_iterations);

  std::vector<std::vector<const ObservedVoxel*>> members(clusters.centres.size());
  for (std::size_t i = 0; i < positive.size(); ++i) {
    members[clusters.cluster_of_point[i]].push_back(&positive[i]);
  }
  std::vector<SoundSource> sources;
  for (std::size_t c = 0; c < members.size(); ++c) {
    if (members[c].empty()) continue;
    SoundSource& source = sources.emplace_back();
    source.position_in_map_m = clusters.centres[c];
    Describe(members[c], std::vector<double>(members[c].size(), 1.0), voxel_size_m, source);
    source.probability = ProbabilityFromLogOdds(source.peak_log_odds);
  }
  return sources;
}

// The weighted mean of the voxels within the core radius, followed until it rests.
class Core {
 public:
  Core(const SupportField& field, const SoundSourceConfig& config, const Eigen::Vector3d& peak)
      : position_in_map_m(peak) {
    constexpr int kMaxSteps = 5;
    for (int step = 0; step < kMaxSteps; ++step) {
      voxels = field.Around(position_in_map_m, config.core_radius_m);
      weights.clear();
      double weight_sum = 0.0;
      Eigen::Vector3d mean = Eigen::Vector3d::Zero();
      for (const ObservedVoxel* voxel : voxels) {
        // Support, by the share of the observations that it is: a place where every scan ends
        // counts no more than one seldom hit.
        const double count = voxel->support.count;
        weights.push_back(count * count / voxel->fields.update_count);
        weight_sum += weights.back();
        mean += weights.back() * CentreOf(*voxel, field.voxel_size_m());
      }
      if (voxels.empty()) return;
      mean /= weight_sum;
      const double moved_m = (mean - position_in_map_m).norm();
      position_in_map_m = mean;
      if (moved_m < 1e-3) return;
    }
  }

  std::vector<const ObservedVoxel*> voxels;  // with support
  std::vector<double> weights;
  Eigen::Vector3d position_in_map_m;
};

// The log-likelihood ratio against the background; none where the share does not exceed it.
std::optional<double> Evidence(const SupportField::Counts& counts,
                               const SoundSourceConfig& config) {
  const double share = std::min(counts.supporting / counts.all, 1.0 - 1e-9);
  if (!(share > config.background_share)) return std::nullopt;
  return counts.supporting * std::log(share / config.background_share) +
         (counts.all - counts.supporting) *
             std::log((1.0 - share) / (1.0 - config.background_share));
}

double ProbabilityOf(double evidence, const SoundSourceConfig& config) {
  return 1.0 / (1.0 + std::pow(config.even_evidence / evidence, config.evidence_power));
}

// What has been accepted so far, by cells so wide that what masks a place is in its cell.
class Accepted {
 public:
  explicit Accepted(const SoundSourceConfig& config)
      : config_(config), cell_m_(std::max(config.separation_m, config.masking_radius_m)) {}

  void Add(const SourceFinder::Candidate& candidate) {
    const Eigen::Vector3i cell = CellOf(candidate.point_in_map_m);
    for (int offset = 0; offset < 27; ++offset) {
      const Eigen::Vector3i step(offset % 3 - 1, offset / 3 % 3 - 1, offset / 9 - 1);
      in_reach_[Number(cell + step)].push_back(candidate);
    }
  }

  bool Masks(const SourceFinder::Candidate& weaker) const {
    const auto near = in_reach_.find(Number(CellOf(weaker.point_in_map_m)));
    if (near == in_reach_.end()) return false;
    return std::any_of(
        near->second.begin(), near->second.end(), [&](const SourceFinder::Candidate& stronger) {
          const double distance_m = (stronger.point_in_map_m - weaker.point_in_map_m).norm();
          const double share =
              config_.masking_share * (1.0 - distance_m / config_.masking_radius_m);
          return distance_m < config_.separation_m || weaker.evidence < share * stronger.evidence;
        });
  }

 private:
  Eigen::Vector3i CellOf(const Eigen::Vector3d& point_in_map_m) const {
    return (point_in_map_m / cell_m_).array().floor().matrix().cast<int>();
  }
  // Cells far apart may share a number, which costs time alone.
  static std::uint64_t Number(const Eigen::Vector3i& cell) {
    std::uint64_t number = 0;
    for (int axis = 0; axis < 3; ++axis) {
      number = number << 21 | (static_cast<std::uint32_t>(cell[axis]) & 0x1fffffu);
    }
    return number;
  }

  const SoundSourceConfig& config_;
  const double cell_m_;
  boost::unordered_flat_map<std::uint64_t, std::vector<SourceFinder::Candidate>> in_reach_;
};

}  // namespace

SourceFinder::SourceFinder(const SoundSourceConfig& config)
    : config_(config), field_(config.smoothing_sigma_m, config.min_updates, config.max_voxels) {}

void SourceFinder::FindCandidates(const Snapshot& snapshot, const TileKey& tile) {
  std::vector<Candidate> candidates;
  field_.ForEachCount(snapshot, tile, config_.background_share,
                      [&](const ObservedVoxel& voxel, const SupportField::Counts& counts) {
                        const auto evidence = Evidence(counts, config_);
                        constexpr double kLeast = 0.01;
                        if (!evidence || ProbabilityOf(*evidence, config_) < kLeast) return;
                        candidates.push_back({CentreOf(voxel, field_.voxel_size_m()), *evidence});
                      });
  if (candidates.empty()) {
    candidates_.erase(tile);
  } else {
    candidates_[tile] = std::move(candidates);
  }
}

std::vector<SoundSource> SourceFinder::FindBySmoothPeaks(const Snapshot& snapshot) {
  for (const TileKey& tile : field_.Follow(snapshot)) FindCandidates(snapshot, tile);
  std::vector<Candidate> candidates;
  for (const auto& [tile, of_tile] : candidates_) {
    candidates.insert(candidates.end(), of_tile.begin(), of_tile.end());
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& a, const auto& b) { return a.evidence > b.evidence; });

  Accepted accepted(config_);
  std::vector<SoundSource> sources;
  for (const Candidate& candidate : candidates) {
    if (sources.size() >= static_cast<std::size_t>(config_.max_sources)) break;
    if (accepted.Masks(candidate)) continue;
    accepted.Add(candidate);
    const Core core(field_, config_, candidate.point_in_map_m);
    if (core.voxels.empty() ||
        std::any_of(sources.begin(), sources.end(), [&](const SoundSource& stronger) {
          return (stronger.position_in_map_m - core.position_in_map_m).norm() <
                 config_.separation_m;
        })) {
      continue;
    }
    SoundSource source;
    source.position_in_map_m = core.position_in_map_m;
    source.probability = ProbabilityOf(candidate.evidence, config_);
    source.evidence = candidate.evidence;
    Describe(core.voxels, core.weights, field_.voxel_size_m(), source);
    if (source.evidence_count >= config_.min_evidence) sources.push_back(source);
  }
  return sources;
}

std::vector<SoundSource> SourceFinder::Find(const Snapshot& snapshot) {
  std::vector<SoundSource> sources = config_.method == SourceMethod::kKMeans
                                         ? FindByKMeans(snapshot, config_)
                                         : FindBySmoothPeaks(snapshot);
  std::sort(sources.begin(), sources.end(), [](const SoundSource& a, const SoundSource& b) {
    return a.probability != b.probability ? a.probability > b.probability : a.id < b.id;
  });
  if (sources.size() > static_cast<std::size_t>(config_.max_sources)) {
    sources.resize(config_.max_sources);
  }
  return sources;
}

std::vector<SoundSource> FindSoundSources(const Snapshot& snapshot,
                                          const SoundSourceConfig& config) {
  return SourceFinder(config).Find(snapshot);
}

}  // namespace soundmap::sound_map
