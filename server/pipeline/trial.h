#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "building/building.h"
#include "pipeline/profile.h"
#include "pipeline/records.h"
#include "pipeline/session.h"
#include "sound_map/registered_source.h"
#include "storage/store.h"

namespace soundmap::pipeline {

// A listening drive that has arrived in full, and the geometric map that it is localized in.
struct TrialDrive {
  SessionRecord record;
  std::shared_ptr<const building::Building> building;
};

// What listening drives lead to with parameters of one's own.
struct Trial {
  std::vector<sound_map::RegisteredSource> sources;  // but for those that are gone
  std::int64_t audio_scans = 0;                      // that gave evidence
};

// Runs the drives, one after the other, from their logs through the pipeline into a sound map that
// nobody else sees, in the profile's band. With the parameters of the site, and drives that came
// one after the other, the sources are those of the site's own map, bit for bit. Cancelled once
// `report(share)` is false.
absl::StatusOr<Trial> TryParameters(const std::vector<TrialDrive>& drives, const Profile& profile,
                                    storage::Store* store, const Session::FrameDecoder& decode,
                                    absl::FunctionRef<bool(double share)> report);

// {"audio_scans", "sources": [{"position_m", "extent_m", "probability", "evidence_count"}]}
std::string ToJson(const Trial& trial);

}  // namespace soundmap::pipeline
