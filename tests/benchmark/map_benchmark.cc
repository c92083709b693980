#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "acoustics/config.h"
#include "geometry/angles.h"
#include "sound_map/sound_map.h"
#include "sound_map/sound_octree.h"
#include "tests/benchmark/require.h"
#include "tests/benchmark/room.h"

// The update of L, M and U with the end points of audio scans, of one robot on its round. The map
// knows the room already: a round later the voxels are the same.
namespace soundmap::benchmarks {
namespace {

using sound_map::EvidenceScan;

constexpr int kScans = 100;

// OctoMap with L, M and U in its nodes, and our rule for them.
class OctoMapPeer : public sound_map::SoundOcTree {
 public:
  explicit OctoMapPeer(const sound_map::SoundMapConfig& config)
      : SoundOcTree(config.voxel_size_m),
        min_log_odds_(static_cast<float>(config.min_log_odds)),
        max_log_odds_(static_cast<float>(config.max_log_odds)) {
    // OctoMap leaves a voxel at its own limits alone, but M and U must go on.
    clamping_thres_min = -std::numeric_limits<float>::infinity();
    clamping_thres_max = std::numeric_limits<float>::infinity();
  }

  void updateNodeLogOdds(sound_map::SoundOcTreeNode* node, const float& update) const override {
    node->setLogOdds(std::clamp(node->getLogOdds() + update, min_log_odds_, max_log_odds_));
    ++node->update_count;
    node->last_update_ns = std::max(node->last_update_ns, stamp_ns_);
  }

  void ApplyEagerly(const EvidenceScan& scan) {
    stamp_ns_ = scan.stamp_ns;
    for (const sound_map::EndPoint& end_point : scan.end_points) {
      const geometry::VoxelKey& key = end_point.key;
      updateNode(octomap::OcTreeKey(key.x, key.y, key.z), LogOdds(end_point.likelihood));
    }
  }

  // In the order of the tree, so that neighbours find their branch in the cache; the inner nodes
  // wait for updateInnerOccupancy().
  void ApplySorted(const EvidenceScan& scan) {
    stamp_ns_ = scan.stamp_ns;
    sorted_.clear();
    for (const sound_map::EndPoint& end_point : scan.end_points) {
      const geometry::VoxelKey& key = end_point.key;
      sorted_.push_back({Spread(key.x) | Spread(key.y) << 1 | Spread(key.z) << 2,
                         {key.x, key.y, key.z},
                         LogOdds(end_point.likelihood)});
    }
    std::stable_sort(sorted_.begin(), sorted_.end(),
                     [](const Update& a, const Update& b) { return a.morton < b.morton; });
    for (const Update& update : sorted_) updateNode(update.key, update.log_odds, true);
  }

 private:
  struct Update {
    std::uint64_t morton;
    octomap::OcTreeKey key;
    float log_odds;
  };

  static std::uint64_t Spread(std::uint64_t bits) {
    bits = (bits | bits << 16) & 0x0000ff0000ffu;
    bits = (bits | bits << 8) & 0x00f00f00f00fu;
    bits = (bits | bits << 4) & 0x0c30c30c30c3u;
    return (bits | bits << 2) & 0x249249249249u;
  }
  // A scan has three likelihoods, mostly in runs.
  float LogOdds(float likelihood) {
    if (likelihood != likelihood_) {
      likelihood_ = likelihood;
      log_odds_ = static_cast<float>(std::log(likelihood / (1.0 - likelihood)));
    }
    return log_odds_;
  }

  float min_log_odds_;
  float max_log_odds_;
  frames::TimeNs stamp_ns_ = 0;
  float likelihood_ = 0.5f;
  float log_odds_ = 0.0f;
  std::vector<Update> sorted_;
};

struct Case {
  Case(const acoustics::AcousticsConfig& acoustics, float p_min, float p_med, float p_max,
       bool merge_shared) {
    const geometry::DirectionGrid grid = acoustics.MakeGrid();
    const Eigen::Vector3d source_in_map_m(6.0, 4.0, 3.0);
    std::mt19937_64 random(1);
    std::normal_distribution<double> noise_m(0.0, 0.015);
    for (int k = 0; k < kScans; ++k) {
      const Eigen::Isometry3d map_from_array = MapFromSensor(k, kScans);
      const Eigen::Vector3d towards_source =
          (map_from_array.inverse() * source_in_map_m).normalized();
      EvidenceScan& scan = scans.emplace_back();
      std::set<geometry::VoxelKey> present;
      for (const Eigen::Vector3d& direction : grid) {
        const double range_m =
            RangeInRoom_m(map_from_array.translation(), map_from_array.linear() * direction) +
            noise_m(random);
        if (range_m > 6.0) continue;
        const auto key =
            geometry::KeyFromPoint(map_from_array * (range_m * direction), config.voxel_size_m)
                .value();
        if (merge_shared && !present.insert(key).second) continue;
        const double angle_rad = std::acos(std::min(1.0, direction.dot(towards_source)));
        const float likelihood = angle_rad < geometry::RadFromDeg(3.0)    ? p_max
                                 : angle_rad < geometry::RadFromDeg(10.0) ? p_med
                                                                          : p_min;
        scan.end_points.push_back({key, likelihood});
      }
      end_points += scan.end_points.size();
    }
    ours = sound_map::SoundMap::Create(config).value();
    eager = std::make_unique<OctoMapPeer>(config);
    sorted = std::make_unique<OctoMapPeer>(config);
    for (int round = 0; round < 2; ++round) {
      NextRound();
      for (const EvidenceScan& scan : scans) {
        Require(ours->Apply(scan).ok(), "our map refuses the evidence");
        eager->ApplyEagerly(scan);
        sorted->ApplySorted(scan);
      }
    }
    sorted->updateInnerOccupancy();
    Check();
    for (const sound_map::TileBlob& tile : ours->TakeDirtyTiles())
      bytes_on_disk += tile.bytes.size();
  }

  // A round takes 100 s.
  void NextRound() {
    for (int k = 0; k < kScans; ++k) {
      stamp_ns += 1'000'000'000;
      scans[k].stamp_ns = stamp_ns;
    }
  }

  // Every voxel of every map.
  void Check() {
    const auto snapshot = ours->TakeSnapshot();
    const auto holds = [](const OctoMapPeer& tree, const geometry::VoxelKey& key,
                          const sound_map::Voxel& voxel) {
      const auto* node = tree.search(octomap::OcTreeKey(key.x, key.y, key.z));
      return node != nullptr && node->update_count == voxel.update_count &&
             node->last_update_ns == voxel.last_update_ns &&
             std::abs(node->getLogOdds() - voxel.log_odds) < 1e-4f;
    };
    bool same = true;
    snapshot->ForEach([&](const geometry::VoxelKey& key, const sound_map::Voxel& voxel) {
      ++voxels;
      same = same && holds(*eager, key, voxel) && holds(*sorted, key, voxel);
      return true;
    });
    Require(same && voxels == eager->getNumLeafNodes() && voxels == sorted->getNumLeafNodes(),
            "the maps are not equal");
  }

  sound_map::SoundMapConfig config = sound_map::DefaultConfig();
  std::vector<EvidenceScan> scans;
  std::size_t end_points = 0;
  std::size_t voxels = 0;
  std::size_t bytes_on_disk = 0;  // of our map's tiles, after two rounds
  frames::TimeNs stamp_ns = 1'700'000'000'000'000'000;
  std::unique_ptr<sound_map::SoundMap> ours;
  std::unique_ptr<OctoMapPeer> eager;
  std::unique_ptr<OctoMapPeer> sorted;
};

// One round an iteration.
template <typename Round>
void Run(benchmark::State& state, Case& c, std::size_t bytes, Round round) {
  for (auto _ : state) {
    c.NextRound();
    round();
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations() * c.end_points));
  state.counters["bytes_per_voxel"] = static_cast<double>(bytes) / static_cast<double>(c.voxels);
}

void Register(const std::string& evidence, const std::shared_ptr<Case>& c) {
  const std::string group = "map_update/" + evidence + "/";
  const auto add = [&group](const char* method, auto run) {
    benchmark::RegisterBenchmark((group + method).c_str(), run)->Unit(benchmark::kMillisecond);
  };
  add("ours", [c](benchmark::State& state) {
    Run(state, *c, c->ours->MemoryBytes(), [&c] {
      for (const EvidenceScan& scan : c->scans) Require(c->ours->Apply(scan).ok(), "refused");
    });
    state.counters["bytes_per_voxel_on_disk"] =
        static_cast<double>(c->bytes_on_disk) / static_cast<double>(c->voxels);
  });
  add("octomap_sorted_lazy", [c](benchmark::State& state) {
    Run(state, *c, c->sorted->memoryUsage(), [&c] {
      for (const EvidenceScan& scan : c->scans) c->sorted->ApplySorted(scan);
      c->sorted->updateInnerOccupancy();
    });
  });
  add("octomap_eager", [c](benchmark::State& state) {
    Run(state, *c, c->eager->memoryUsage(), [&c] {
      for (const EvidenceScan& scan : c->scans) c->eager->ApplyEagerly(scan);
    });
  });
}

}  // namespace
}  // namespace soundmap::benchmarks

int main(int argc, char** argv) {
  using soundmap::acoustics::AcousticsConfig;
  using soundmap::benchmarks::Case;
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  soundmap::benchmarks::Register(
      "paper", std::make_shared<Case>(AcousticsConfig::Paper(), 0.1f, 0.5f, 0.999f, false));
  soundmap::benchmarks::Register(
      "default", std::make_shared<Case>(AcousticsConfig::Default(), 0.4f, 0.5f, 0.9f, true));
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
