#include "pipeline/content_check.h"

#include <map>
#include <memory>

#include "absl/strings/str_cat.h"
#include "building/stored_building.h"
#include "pipeline/archive.h"
#include "pipeline/profile.h"
#include "pipeline/records.h"
#include "sound_map/tile_blob.h"

namespace soundmap::pipeline {

storage::ContentCheck MakeContentCheck() {
  // By site, from its record.
  auto voxel_sizes = std::make_shared<std::map<std::string, double>>();
  storage::ContentCheck check;
  check.record = [voxel_sizes](storage::Table table, const std::string& key,
                               const std::string& bytes) -> absl::Status {
    if (table == storage::Table::kSite) {
      const auto record = SiteRecordFromJson(bytes);
      if (!record.ok()) return record.status();
      const auto profile = ProfileFromToml(record->parameters_toml);
      if (!profile.ok()) return profile.status();
      (*voxel_sizes)[key] = profile->sound_map.voxel_size_m;
      return absl::OkStatus();
    }
    if (table == storage::Table::kSession) return SessionRecordFromJson(bytes).status();
    if (table == storage::Table::kBuilding) return building::ParseBuilding(bytes).status();
    return absl::OkStatus();
  };
  check.pose = [](const std::string& pose) { return DecodePose(pose).status(); };
  check.summary = [](const std::string&, const std::string& summary) {
    return DecodeAudioScan(summary).status();
  };
  check.tile = [voxel_sizes](const std::string& site, const storage::Tile& tile) {
    const auto size_m = voxel_sizes->find(site);
    if (size_m == voxel_sizes->end()) return absl::OkStatus();  // said already, of the site
    return sound_map::ParseTile({{tile.key.x, tile.key.y, tile.key.z}, tile.bytes}, size_m->second)
        .status();
  };
  return check;
}

}  // namespace soundmap::pipeline
