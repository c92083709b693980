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
  struct Site {
    double voxel_size_m = 0.0;
    std::size_t maps = 1;
  };
  // By name, from their records.
  auto sites = std::make_shared<std::map<std::string, Site>>();
  // A site without a record that can be read has been told of already.
  const auto check_band = [sites](const std::string& name, std::size_t band) -> absl::Status {
    const auto site = sites->find(name);
    if (site == sites->end() || band < site->second.maps) return absl::OkStatus();
    return absl::DataLossError(absl::StrCat("the site has no band ", band));
  };
  storage::ContentCheck check;
  check.record = [sites](storage::Table table, const std::string& key,
                         const std::string& bytes) -> absl::Status {
    if (table == storage::Table::kSite) {
      const auto record = SiteRecordFromJson(bytes);
      if (!record.ok()) return record.status();
      const auto profile = ProfileFromToml(record->parameters_toml);
      if (!profile.ok()) return profile.status();
      (*sites)[key] = {profile->sound_map.voxel_size_m, 1 + record->bands.size()};
      return ValidateBands(record->bands, *profile);
    }
    if (table == storage::Table::kSession) return SessionRecordFromJson(bytes).status();
    if (table == storage::Table::kBuilding) return building::ParseBuilding(bytes).status();
    return absl::OkStatus();
  };
  check.pose = [](const std::string& pose) { return DecodePose(pose).status(); };
  check.summary = [check_band](const std::string& site, const std::string& summary) {
    const auto scan = DecodeAudioScan(summary);
    return scan.ok() ? check_band(site, scan->band) : scan.status();
  };
  check.tile = [sites, check_band](const std::string& name, const storage::Tile& tile) {
    const auto site = sites->find(name);
    if (site == sites->end()) return absl::OkStatus();
    const absl::Status known = check_band(name, tile.key.band);
    if (!known.ok()) return known;
    return sound_map::ParseTile({{tile.key.x, tile.key.y, tile.key.z}, tile.bytes},
                                site->second.voxel_size_m)
        .status();
  };
  return check;
}

}  // namespace soundmap::pipeline
