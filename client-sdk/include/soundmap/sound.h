#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "soundmap/poses.h"

namespace soundmap {

enum class SoundSourceState {
  kUnknown,
  kActive,  // heard when it was last listened to
  kSilent,  // listened to since, and not heard
  kGone,    // silent for so long that it counts as removed
};

// A stretch of capture time in which a source was heard, with pauses of at most a minute.
struct HeardPeriod {
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;
};

struct OctaveBandLevel {
  double centre_hz = 0.0;
  double level_db = 0.0;
  std::optional<double> spl_db;
};

// An object that lasts: its id stays while more is heard of it.
struct SoundSource {
  std::string id;
  std::string site;
  Vector3 position_in_map_m;
  double extent_m = 0.0;  // edge of the cube of equal spread
  double probability = 0.0;
  std::int64_t evidence_count = 0;
  std::int64_t first_heard_ns = 0;
  std::int64_t last_heard_ns = 0;
  double peak_log_odds = 0.0;
  std::int64_t voxel_count = 0;
  SoundSourceState state = SoundSourceState::kUnknown;
  std::optional<std::array<double, 9>> position_covariance_m2;  // row-major
  std::int64_t view_point_count = 0;  // places a metre apart from which it was heard
  std::vector<std::string> robots;    // that heard it
  std::int64_t last_listened_ns = 0;  // newest scan that reached its place, heard or not
  // GetSoundSource(): all that is kept. ListSoundSources(): those in the query's window.
  std::vector<HeardPeriod> heard_periods;
  // At 1 m; 0 dB is a full-scale square wave at the microphones.
  std::optional<double> level_db;
  std::vector<OctaveBandLevel> spectrum;  // of bands that were measured and where it stands out
  // Sound pressure level at 1 m in dB re 20 uPa; none: no robot with calibrated microphones heard
  // it.
  std::optional<double> spl_db;
  // Where it may be instead: the arrays that heard it cannot tell above from below.
  std::optional<Vector3> mirror_in_map_m;
  // Id of the stronger source of which this is a ghost, most likely; empty: none explains it.
  std::string explained_by;
  std::string band;  // that it is heard in; empty: that of the site's profile
};

// What happened to a source, beside the changes of its fields.
struct SoundSourceEvent {
  enum class Kind { kUnknown, kAppeared, kFellSilent, kActiveAgain, kVanished, kMerged, kMoved };
  Kind kind = Kind::kUnknown;
  std::int64_t time_ns = 0;  // capture time of the scan at which it was noticed
  SoundSource source;
  std::string other_id;  // kMerged: what it is part of now; kMoved: its new place's until then
  std::optional<Vector3> from_in_map_m;  // kMoved
};

// `revision`: of the map that the answer was read from; `as_of_ns`: capture time of its last
// evidence.
struct SoundSourceList {
  std::vector<SoundSource> sources;  // most probable first, then by id
  std::int64_t revision = 0;
  std::int64_t as_of_ns = 0;
};

// `band` in what follows: the name of one of the site's bands; empty: the band of its profile.
struct SoundSourceQuery {
  std::string site;
  double min_probability = 0.0;
  std::int64_t since_ns = 0;  // last heard at or after; 0: ever
  // Heard in start_ns <= time < end_ns. Both 0: no such condition; end_ns 0: open.
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;
  std::vector<SoundSourceState> states;  // empty: all; but those that are gone only with a window
  std::string band;
};

struct VoxelQuery {
  std::string site;
  std::optional<Box> box_in_map;  // absent: the whole map
  std::int64_t min_updates = 0;
  double min_probability = 0.0;
  std::string band;
};

// Columns of equal length, one entry a voxel.
struct VoxelColumns {
  std::int64_t revision = 0;
  std::int64_t as_of_ns = 0;
  double voxel_size_m = 0.0;
  std::vector<std::uint32_t> x_key, y_key, z_key;
  std::vector<float> log_odds;
  std::vector<std::uint32_t> update_count;
  std::vector<std::int64_t> last_update_ns;

  std::size_t size() const { return x_key.size(); }
  // Centre of voxel i in `map`.
  Vector3 CenterInMap(std::size_t i) const {
    const auto center = [this](std::uint32_t key) {
      return (static_cast<double>(key) - 32768.0 + 0.5) * voxel_size_m;
    };
    return {center(x_key[i]), center(y_key[i]), center(z_key[i])};
  }
};

// A direction, in `mic_array`, in which one audio scan had a local maximum of power.
struct AudioPeak {
  double azimuth_rad = 0.0;    // counter-clockwise from x
  double elevation_rad = 0.0;  // up from the x-y plane
  double power = 0.0;          // S of eq. (5)
};

struct AudioScan {
  std::string session;
  std::string robot;
  std::int64_t time_ns = 0;  // middle of the scan
  std::optional<PoseEstimate> pose;
  double noise_floor = 0.0;  // of S
  std::vector<AudioPeak> peaks;
  std::int64_t end_point_count = 0;
  std::string band;
};

struct AudioScanQuery {
  std::string site;
  std::string session;  // empty: all
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;  // exclusive; 0: open
  std::string band;
};

}  // namespace soundmap
