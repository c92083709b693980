#pragma once

#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "frames/frames.h"
#include "sound_map/evidence.h"

namespace soundmap::storage {

// One audio scan's evidence in the journal of its site.
struct JournalEntry {
  std::int64_t offset = 0;           // of the frame that completed the scan
  std::string summary;               // the pipeline's own bytes: pose, noise floor, peaks
  sound_map::EvidenceScan evidence;  // bit-exact and in order; at most 2^20 end points
};

struct JournalRecord {
  std::uint64_t sequence =
      0;  // counts the entries of the site from 1; the order in which the map was changed
  std::string session;
  JournalEntry entry;
};

struct TrajectoryEntry {
  frames::TimeNs time_ns = 0;  // an entry of the same session and time replaces the earlier one
  std::string pose;            // the pipeline's own bytes
};

struct StateSnapshot {
  std::int64_t offset = 0;  // the state after the frames before this offset
  std::string state;        // the pipeline's own bytes
};

// What the processing of some frames of one session left behind; takes effect as a whole or not at
// all.
struct Commit {
  std::string site;
  std::string session;
  std::int64_t processed_offset = 0;  // frames 0 .. processed_offset-1 have moved the robot
  // Frames 0 .. heard_offset-1 have had their effect on the sound map, too. Behind processed_offset
  // while the robot does not know where it is: what it heard waits in the session log.
  std::int64_t heard_offset = 0;
  std::vector<JournalEntry> journal;
  std::vector<TrajectoryEntry> trajectory;
  std::optional<StateSnapshot> state;  // replaces the one before
};

// A cube of 32^3 voxels of one of the site's maps: voxel key / 32 on each axis, below 2048.
struct TileKey {
  std::uint16_t x = 0;
  std::uint16_t y = 0;
  std::uint16_t z = 0;
  std::uint8_t band = 0;  // number of the map, at most kMaxBand

  static constexpr std::uint8_t kMaxBand = 127;

  bool operator==(const TileKey&) const = default;
  // As the keys in the database sort: map by map.
  std::strong_ordering operator<=>(const TileKey& other) const {
    return std::tie(band, x, y, z) <=> std::tie(other.band, other.x, other.y, other.z);
  }
};

struct Tile {
  TileKey key;
  std::string bytes;  // the sound map's own; empty removes the tile
};

}  // namespace soundmap::storage
