#pragma once

#include <nlohmann/json.hpp>

#include "soundmap/map_files.h"
#include "soundmap/resources.h"
#include "soundmap/sound.h"
#include "soundmap/watch.h"

// The CLI's JSON. The same data gives the same bytes: keys keep their order, numbers are the
// shortest that read back the same.
namespace soundmap::cli {

using Json = nlohmann::ordered_json;

// A float as the shortest decimal that names it, not its digits as a double.
double ShortestDecimal(float value);

Json ToJson(const Vector3& vector);  // [x, y, z]
Json ToJson(const Site& site);
Json ToJson(const Session& session);
Json ToJson(const Robot& robot);
Json ToJson(const LiveView& live);
Json ToJson(const ClockOffset& offset);
Json ToJson(const Operation& operation);
Json ToJson(const PoseEstimate& pose);
Json ToJson(const SoundSource& source);
Json ToJson(const SoundSourceList& list, const std::string& site);
Json ToJson(const AudioScan& scan);
// One voxel of the columns.
Json ToJson(const VoxelColumns& voxels, std::size_t i);
Json ToJson(const ExportedMap& exported);
// None for a heartbeat.
std::optional<Json> ToJson(const WatchEvent& event);

// {"sites": [...]} and the like.
template <typename Item>
Json ListToJson(const char* key, const std::vector<Item>& items) {
  Json list = Json::array();
  for (const Item& item : items) list.push_back(ToJson(item));
  Json document;
  document[key] = std::move(list);
  return document;
}

const char* NameOf(LocalizationState state);
const char* NameOf(Purpose purpose);
const char* NameOf(SessionState state);
const char* NameOf(SoundSourceState state);

}  // namespace soundmap::cli
