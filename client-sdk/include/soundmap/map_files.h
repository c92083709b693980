#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "soundmap/poses.h"
#include "soundmap/resources.h"

namespace soundmap {

struct BuildMapRequest {
  std::string site;
  // The first fixes the map frame. Empty: all mapping sessions of the site, oldest first; with
  // surveyed poses the newest; with `extend` those that are not in the map yet.
  std::vector<std::string> sessions;
  // Surveyed poses to use instead of registration, oldest first.
  std::vector<StampedPose> surveyed_poses;
  bool extend = false;  // the present map, its frame and surfaces stay; the sessions are added
};

struct TryParametersRequest {
  std::string site;
  std::vector<std::string> sessions;  // empty: all listening sessions that are complete
  // A trial each: `profile = "default"` or "paper", then the parameters that differ.
  std::vector<std::string> parameters_toml;
};

enum class ExportWhat { kSound, kGeometry, kFloorPlan };

struct ExportMapRequest {
  std::string site;
  ExportWhat what = ExportWhat::kSound;
  std::string format;  // "ot", "bt", "ply", "pcd", "mcap", "png", "yaml"
  bool full = false;   // sound, ot: all three voxel fields instead of OctoMap's log-odds
  std::int64_t min_updates = 0;
  std::string band;  // sound; empty: that of the site's profile
};

struct ExportedMap {
  std::int64_t revision = 0;
  std::int64_t as_of_ns = 0;
  std::vector<std::string> files;  // paths as written
  std::int64_t bytes = 0;
};

// Called while an operation runs. Returns whether to go on; false cancels the operation.
using ProgressCallback = std::function<bool(const Operation&)>;

// Called with the bytes sent or received so far. Returns whether to go on.
using BytesCallback = std::function<bool(std::int64_t bytes)>;

}  // namespace soundmap
