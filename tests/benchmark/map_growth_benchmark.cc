#include <benchmark/benchmark.h>
#include <unistd.h>

#include <map>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "sound_map/sound_map.h"
#include "sound_map/voxel_query.h"
#include "tests/benchmark/require.h"

// How cost grows with the voxels of the map: rooms of 12 x 8 x 3 m side by side, all their surfaces
// known, and robots that are somewhere else at every scan, so that nothing is in the cache.
namespace soundmap::benchmarks {
namespace {

using geometry::VoxelKey;
using sound_map::EvidenceScan;

constexpr int kLength = 240, kWidth = 160, kHeight = 60;  // of a room, in voxels
constexpr int kRoomsInARow = 64;
constexpr int kPitch = 250;                  // between rooms, in voxels
constexpr int kFirstKey = 40000;             // the middle of the keys lies inside the grid
constexpr int kScanEndPoints = 4636;         // of the paper's scan
constexpr std::int64_t kBytesPerVoxel = 20;  // more than a map takes

VoxelKey KeyInRoom(int room, int x, int y, int z) {
  return {static_cast<std::uint16_t>(kFirstKey - kRoomsInARow / 2 * kPitch +
                                     room % kRoomsInARow * kPitch + x),
          static_cast<std::uint16_t>(kFirstKey - kRoomsInARow / 2 * kPitch +
                                     room / kRoomsInARow * kPitch + y),
          static_cast<std::uint16_t>(32768 + z)};
}

// The surface of the first room, face by face and row by row.
std::vector<VoxelKey> Surface() {
  std::vector<VoxelKey> keys;
  for (int z = 0; z < kHeight; ++z) {
    for (int y = 0; y < kWidth; ++y) {
      for (int x = 0; x < kLength; ++x) {
        if (x == 0 || x == kLength - 1 || y == 0 || y == kWidth - 1 || z == 0 || z == kHeight - 1)
          keys.push_back(KeyInRoom(0, x, y, z));
      }
    }
  }
  return keys;
}

VoxelKey MovedTo(int room, const VoxelKey& key) {
  return {static_cast<std::uint16_t>(key.x + room % kRoomsInARow * kPitch),
          static_cast<std::uint16_t>(key.y + room / kRoomsInARow * kPitch), key.z};
}

class Building {
 public:
  explicit Building(std::int64_t voxels) {
    map_ = sound_map::SoundMap::Create(sound_map::DefaultConfig()).value();
    const std::vector<VoxelKey> surface = Surface();
    for (std::int64_t made = 0; made < voxels; ++rooms_) {
      const auto count =
          std::min<std::int64_t>(voxels - made, static_cast<std::int64_t>(surface.size()));
      EvidenceScan scan = Scan(rooms_, surface, 0, static_cast<std::size_t>(count));
      Require(map_->Apply(scan).ok(), "our map refuses the evidence");
      made += count;
    }
    voxels_ = voxels;
    Require(static_cast<std::int64_t>(map_->TakeSnapshot()->voxel_count()) == voxels,
            "the map does not have the voxels that it was given");
    // Scans of a part of a surface each, everywhere.
    const std::size_t known =
        std::min<std::size_t>(surface.size(), static_cast<std::size_t>(voxels));
    for (int i = 0; i < 256; ++i) {
      const int room = static_cast<int>(random_() % static_cast<unsigned>(rooms_));
      const std::size_t first = random_() % (known - kScanEndPoints);
      // The last room may be a part of one.
      scans_.push_back(Scan(room == rooms_ - 1 ? 0 : room, surface, first, kScanEndPoints));
    }
  }

  void NextScan() {
    EvidenceScan& scan = scans_[next_++ % scans_.size()];
    scan.stamp_ns = stamp_ns_ += 125'000'000;
    Require(map_->Apply(scan).ok(), "our map refuses the evidence");
  }
  sound_map::VoxelQuery NextBox() {
    const EvidenceScan& scan = scans_[next_++ % scans_.size()];
    const Eigen::Vector3d centre = geometry::PointFromKey(scan.end_points[0].key, 0.05);
    sound_map::VoxelQuery query;
    query.min_in_map_m = centre.array() - 1.0;
    query.max_in_map_m = centre.array() + 1.0;
    query.limit = 1 << 20;
    return query;
  }
  const sound_map::SoundMap& map() const { return *map_; }
  double bytes_per_voxel() const {
    return static_cast<double>(map_->MemoryBytes()) / static_cast<double>(voxels_);
  }

 private:
  EvidenceScan Scan(int room, const std::vector<VoxelKey>& surface, std::size_t first,
                    std::size_t count) {
    EvidenceScan scan;
    scan.stamp_ns = stamp_ns_ += 125'000'000;
    scan.end_points.reserve(count);
    for (std::size_t i = first; i < first + count; ++i) {
      scan.end_points.push_back({MovedTo(room, surface[i]), 0.4f});
    }
    return scan;
  }

  std::mt19937 random_{1};
  std::unique_ptr<sound_map::SoundMap> map_;
  std::vector<EvidenceScan> scans_;
  std::size_t next_ = 0;
  int rooms_ = 0;
  std::int64_t voxels_ = 0;
  frames::TimeNs stamp_ns_ = 1'700'000'000'000'000'000;
};

// Made at first use; null where the memory does not suffice.
Building* BuildingOf(benchmark::State& state) {
  static std::map<std::int64_t, std::unique_ptr<Building>> buildings;
  const std::int64_t voxels = state.range(0);
  auto& building = buildings[voxels];
  if (!building) {
    const std::int64_t free_bytes =
        static_cast<std::int64_t>(::sysconf(_SC_AVPHYS_PAGES)) * ::sysconf(_SC_PAGESIZE);
    if (free_bytes < 2 * kBytesPerVoxel * voxels) {
      state.SkipWithError("too little memory is free");
      return nullptr;
    }
    building = std::make_unique<Building>(voxels);
  }
  return building.get();
}

void Update(benchmark::State& state) {
  Building* const building = BuildingOf(state);
  if (building == nullptr) return;
  for (auto _ : state) building->NextScan();
  state.SetItemsProcessed(state.iterations() * kScanEndPoints);
  state.counters["bytes_per_voxel"] = building->bytes_per_voxel();
}

void BoxQuery(benchmark::State& state) {
  Building* const building = BuildingOf(state);
  if (building == nullptr) return;
  const auto snapshot = building->map().TakeSnapshot();
  std::size_t voxels = 0;
  for (auto _ : state) {
    const auto page = sound_map::FindVoxels(*snapshot, building->NextBox());
    Require(page.ok(), "the query is refused");
    voxels += page->keys.size();
  }
  state.counters["voxels"] = static_cast<double>(voxels) / static_cast<double>(state.iterations());
}

// A view of the map between two scans, and the copies that the second of them makes because of it.
void SnapshotAndUpdate(benchmark::State& state) {
  Building* const building = BuildingOf(state);
  if (building == nullptr) return;
  for (auto _ : state) {
    benchmark::DoNotOptimize(building->map().TakeSnapshot());
    building->NextScan();
  }
}

BENCHMARK(Update)
    ->Name("growth_voxels/update_of_a_scan")
    ->RangeMultiplier(10)
    ->Range(100'000, 100'000'000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(BoxQuery)
    ->Name("growth_voxels/box_query_2_m")
    ->RangeMultiplier(10)
    ->Range(100'000, 100'000'000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(SnapshotAndUpdate)
    ->Name("growth_voxels/update_after_a_snapshot")
    ->RangeMultiplier(10)
    ->Range(100'000, 100'000'000)
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace soundmap::benchmarks
