#include "sound_map/voxel_query.h"

#include <algorithm>
#include <cmath>

#include "sound_map/tile.h"

namespace soundmap::sound_map {
namespace {

// Ascending in map order.
std::uint64_t MapOrder(const geometry::VoxelKey& key) {
  const TileKey tile = TileOf(key);
  return std::uint64_t{tile.x} << 37 | std::uint64_t{tile.y} << 26 | std::uint64_t{tile.z} << 15 |
         static_cast<std::uint64_t>(Tile::BlockOf(key)) << 9 |
         static_cast<std::uint64_t>(Tile::VoxelOf(key));
}

}  // namespace

absl::StatusOr<VoxelPage> FindVoxels(const Snapshot& snapshot, const VoxelQuery& query) {
  if (query.limit < 1) return absl::InvalidArgumentError("the limit of voxels is below 1");
  if (!(query.min_probability >= 0.0 && query.min_probability <= 1.0)) {
    return absl::InvalidArgumentError("the least probability of the voxels is not in [0, 1]");
  }
  geometry::VoxelKey min;
  geometry::VoxelKey max;
  const double size_m = snapshot.voxel_size_m();
  for (int axis = 0; axis < 3; ++axis) {
    const double low_m = query.min_in_map_m[axis];
    const double high_m = query.max_in_map_m[axis];
    if (!(low_m <= high_m)) {
      return absl::InvalidArgumentError(
          "the box of voxels has a lower bound that is above its upper bound or not a number");
    }
    // The centre of voxel k lies at (k - 32768 + 0.5) * size.
    const double first = std::ceil(low_m / size_m - 0.5) + geometry::VoxelKey::kCentre;
    const double last = std::floor(high_m / size_m - 0.5) + geometry::VoxelKey::kCentre;
    if (last < 0.0 || first > 65535.0 || last < first) return VoxelPage{};
    std::uint16_t geometry::VoxelKey::*const part[] = {
        &geometry::VoxelKey::x, &geometry::VoxelKey::y, &geometry::VoxelKey::z};
    min.*part[axis] = static_cast<std::uint16_t>(std::max(first, 0.0));
    max.*part[axis] = static_cast<std::uint16_t>(std::min(last, 65535.0));
  }

  VoxelPage page;
  const std::optional<std::uint64_t> after =
      query.after ? std::optional(MapOrder(*query.after)) : std::nullopt;
  snapshot.ForEachInBox(min, max, [&](const geometry::VoxelKey& key, const Voxel& voxel) {
    if (voxel.update_count <= query.min_updates ||
        ProbabilityFromLogOdds(voxel.log_odds) < query.min_probability ||
        (after && MapOrder(key) <= *after)) {
      return true;
    }
    if (page.keys.size() == static_cast<std::size_t>(query.limit)) {
      page.more = true;
      return false;
    }
    page.keys.push_back(key);
    page.voxels.push_back(voxel);
    return true;
  });
  return page;
}

}  // namespace soundmap::sound_map
