#include "sound_map/export.h"

#include <octomap/OcTree.h>

#include <ostream>
#include <string>
#include <type_traits>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "sound_map/color_map.h"
#include "sound_map/sound_octree.h"

namespace soundmap::sound_map {
namespace {

constexpr std::size_t kWriteBytes = 1 << 16;

template <typename T>
void Put(std::string& bytes, T value) {
  static_assert(std::is_arithmetic_v<T>);
  bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

octomap::OcTreeKey OcTreeKeyOf(const geometry::VoxelKey& key) { return {key.x, key.y, key.z}; }

absl::Status CheckStream(const std::ostream& stream) {
  return stream.good() ? absl::OkStatus()
                       : absl::UnavailableError("the export of the sound map could not be written");
}

// Calls visit(key, voxel) for the voxels with M > min_updates and returns their number.
template <typename Visit>
std::size_t ForEachOccupied(const Snapshot& snapshot, std::uint32_t min_updates, Visit visit) {
  std::size_t count = 0;
  snapshot.ForEach([&](const geometry::VoxelKey& key, const Voxel& voxel) {
    if (voxel.update_count > min_updates) {
      visit(key, voxel);
      ++count;
    }
    return true;
  });
  return count;
}

// Writes one record a voxel, in pieces.
template <typename PutRecord>
absl::Status WriteRecords(const Snapshot& snapshot, std::uint32_t min_updates, std::ostream& stream,
                          PutRecord put_record) {
  std::string bytes;
  ForEachOccupied(snapshot, min_updates, [&](const geometry::VoxelKey& key, const Voxel& voxel) {
    const Eigen::Vector3f centre_in_map =
        geometry::PointFromKey(key, snapshot.voxel_size_m()).cast<float>();
    for (int axis = 0; axis < 3; ++axis) Put(bytes, centre_in_map[axis]);
    put_record(bytes, voxel);
    if (bytes.size() < kWriteBytes) return;
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    bytes.clear();
  });
  stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  return CheckStream(stream);
}

std::size_t CountOccupied(const Snapshot& snapshot, std::uint32_t min_updates) {
  return ForEachOccupied(snapshot, min_updates, [](const auto&, const auto&) {});
}

}  // namespace

absl::Status WriteOcTree(const Snapshot& snapshot, std::uint32_t min_updates,
                         std::ostream& stream) {
  octomap::OcTree tree(snapshot.voxel_size_m());
  ForEachOccupied(snapshot, min_updates, [&](const geometry::VoxelKey& key, const Voxel& voxel) {
    // setNodeValue() would clamp.
    tree.setNodeValue(OcTreeKeyOf(key), 0.0f, /*lazy_eval=*/true)->setLogOdds(voxel.log_odds);
  });
  tree.updateInnerOccupancy();
  if (!tree.write(stream)) return absl::InternalError("OctoMap did not write the octree");
  return CheckStream(stream);
}

absl::Status WriteSoundOcTree(const Snapshot& snapshot, std::uint32_t min_updates,
                              std::ostream& stream) {
  SoundOcTree tree(snapshot.voxel_size_m());
  ForEachOccupied(snapshot, min_updates, [&](const geometry::VoxelKey& key, const Voxel& voxel) {
    SoundOcTreeNode* node = tree.setNodeValue(OcTreeKeyOf(key), 0.0f, /*lazy_eval=*/true);
    node->setLogOdds(voxel.log_odds);
    node->update_count = voxel.update_count;
    node->last_update_ns = voxel.last_update_ns;
  });
  tree.UpdateInnerNodes();
  if (!tree.write(stream)) return absl::InternalError("OctoMap did not write the octree");
  return CheckStream(stream);
}

absl::Status WriteOccupancy(const Snapshot& snapshot, std::uint32_t min_updates,
                            std::ostream& stream) {
  octomap::OcTree tree(snapshot.voxel_size_m());
  ForEachOccupied(snapshot, min_updates, [&](const geometry::VoxelKey& key, const Voxel&) {
    tree.setNodeValue(OcTreeKeyOf(key), tree.getClampingThresMaxLog(), /*lazy_eval=*/true);
  });
  tree.updateInnerOccupancy();
  tree.prune();
  if (!tree.writeBinaryConst(stream))
    return absl::InternalError("OctoMap did not write the octree");
  return CheckStream(stream);
}

absl::Status WritePly(const Snapshot& snapshot, std::uint32_t min_updates, std::ostream& stream) {
  stream << "ply\nformat binary_little_endian 1.0\ncomment sound map\nelement vertex "
         << CountOccupied(snapshot, min_updates)
         << "\nproperty float x\nproperty float y\nproperty float z\nproperty float log_odds\n"
            "property uint update_count\nproperty double last_update_s\n"
            "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
  return WriteRecords(snapshot, min_updates, stream, [](std::string& bytes, const Voxel& voxel) {
    Put(bytes, voxel.log_odds);
    Put(bytes, voxel.update_count);
    Put(bytes, static_cast<double>(voxel.last_update_ns) * 1e-9);
    const Color color = ColorOfLogOdds(voxel.log_odds);
    Put(bytes, color.red);
    Put(bytes, color.green);
    Put(bytes, color.blue);
  });
}

absl::Status WritePcd(const Snapshot& snapshot, std::uint32_t min_updates, std::ostream& stream) {
  const std::size_t count = CountOccupied(snapshot, min_updates);
  stream << "# .PCD v0.7 - sound map\nVERSION 0.7\n"
            "FIELDS x y z log_odds update_count last_update_ns\nSIZE 4 4 4 4 4 8\n"
            "TYPE F F F F U I\nCOUNT 1 1 1 1 1 1\nWIDTH "
         << count << "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " << count << "\nDATA binary\n";
  return WriteRecords(snapshot, min_updates, stream, [](std::string& bytes, const Voxel& voxel) {
    Put(bytes, voxel.log_odds);
    Put(bytes, voxel.update_count);
    Put(bytes, voxel.last_update_ns);
  });
}

}  // namespace soundmap::sound_map
