#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <vector>

#include "sound_map/config.h"
#include "sound_map/snapshot.h"
#include "sound_map/support_field.h"

namespace soundmap::sound_map {

struct SoundSource {
  // Of the voxel that was heard first and of when that was: the same after a restart, and while
  // more is heard of the source.
  std::uint64_t id = 0;
  Eigen::Vector3d position_in_map_m = Eigen::Vector3d::Zero();
  double extent_m = 0.0;             // edge of the square that spreads as far as its voxels do
  double probability = 0.0;          // that there is a source here
  double evidence = 0.0;             // e below; 0 by kKMeans
  std::uint64_t evidence_count = 0;  // supporting observations of its voxels
  int voxel_count = 0;
  float peak_log_odds = 0.0f;  // largest L of its voxels
  frames::TimeNs first_heard_ns = 0;
  frames::TimeNs last_heard_ns = 0;

  bool operator==(const SoundSource&) const = default;
};

// The sound sources of the map, the most probable first, then by id. A pure function of the
// snapshot's voxels. The configuration must be valid. kKMeans is section VI: a source is the centre
// of a cluster of voxels with L > 0, as probable as its voxel of the largest L. kSmoothPeak
// deviates: L alone tells a weak source beside louder ones, which is not heard in most scans, from
// a ghost of a loud one badly. Around a voxel, s of n observations, weighted by a Gaussian,
// supported a source. With r = s / n the evidence is
//   e = s log(r / r0) + (n - s) log((1 - r) / (1 - r0)),
// a source that is heard in the share r of the scans against the background r0, and the odds
// are (e / e_even)^power. Maxima are sources
// unless a stronger one masks them. The position is the mean of the voxels around, each with the
// weight support^2 / update_count.
std::vector<SoundSource> FindSoundSources(const Snapshot& snapshot,
                                          const SoundSourceConfig& config);

// FindSoundSources() of one growing map, asked again and again: what tiles that stayed as they were
// say is remembered. Its snapshots must be those of one map, whose tiles are loaded before.
class SourceFinder {
 public:
  explicit SourceFinder(const SoundSourceConfig& config);

  std::vector<SoundSource> Find(const Snapshot& snapshot);

  // A voxel that may be where a source is.
  struct Candidate {
    Eigen::Vector3d point_in_map_m;
    double evidence = 0.0;
  };

 private:
  void FindCandidates(const Snapshot& snapshot, const TileKey& tile);
  std::vector<SoundSource> FindBySmoothPeaks(const Snapshot& snapshot);

  const SoundSourceConfig config_;
  SupportField field_;
  std::map<TileKey, std::vector<Candidate>> candidates_;
};

}  // namespace soundmap::sound_map
