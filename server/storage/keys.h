#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "frames/frames.h"
#include "storage/bytes.h"
#include "storage/store.h"

// The keys of the database, as FORMAT.md lists them.
namespace soundmap::storage {

// Keys begin with the site and a byte 0, which no name contains: no site's keys begin with another
// site's.
inline constexpr char kEnd = '\0';
inline constexpr char kAfterEnd = '\1';

inline std::string SiteKey(const std::string& site) { return site + kEnd; }
inline std::string LastSequenceKey(const std::string& site) { return SiteKey(site) + 'j'; }
inline std::string CheckpointKey(const std::string& site) { return SiteKey(site) + 'c'; }
inline std::string SourceRegisterKey(const std::string& site) { return SiteKey(site) + 'r'; }
inline std::string DeletedSiteKey(const std::string& site) { return kEnd + site; }

inline std::string SessionKey(const SessionId& id) {
  return SiteKey(id.site) + 's' + id.session + kEnd;
}
inline std::string DurableKey(const SessionId& id) { return SessionKey(id) + 'd'; }
inline std::string ProcessedKey(const SessionId& id) { return SessionKey(id) + 'p'; }
inline std::string HeardKey(const SessionId& id) { return SessionKey(id) + 'h'; }
inline std::string DroppedKey(const SessionId& id) { return SessionKey(id) + 'x'; }
inline std::string StateKey(const SessionId& id) { return SessionKey(id) + 't'; }

inline std::string EntryPrefix(const std::string& site) { return SiteKey(site) + 'e'; }
inline std::string EntryKey(const std::string& site, std::uint64_t sequence) {
  std::string key = EntryPrefix(site);
  AppendBigEndian(sequence, 8, &key);
  return key;
}

inline std::string TimePrefix(const std::string& site) { return SiteKey(site) + 't'; }
inline std::string TimeKey(const std::string& site, frames::TimeNs stamp_ns) {
  std::string key = TimePrefix(site);
  AppendBigEndian(SortableFromSigned(stamp_ns), 8, &key);
  return key;
}

inline std::string TrajectoryPrefix(const SessionId& id) {
  return SiteKey(id.site) + id.session + kEnd;
}
inline std::string TrajectoryKey(const SessionId& id, frames::TimeNs time_ns) {
  std::string key = TrajectoryPrefix(id);
  AppendBigEndian(SortableFromSigned(time_ns), 8, &key);
  return key;
}

// Set in the byte that says the band of a tile: no byte of a tile's x, which is below 2048, has it.
inline constexpr std::uint8_t kBandMark = 0x80;
inline std::string TileKeyBytes(const std::string& site, const TileKey& tile) {
  std::string key = SiteKey(site);
  if (tile.band != 0) key.push_back(static_cast<char>(kBandMark | tile.band));
  for (const std::uint16_t axis : {tile.x, tile.y, tile.z}) AppendBigEndian(axis, 2, &key);
  return key;
}

// Of what follows the site in a tile's key; none: no such key.
inline std::optional<TileKey> TileKeyFromBytes(std::string_view bytes) {
  TileKey tile;
  if (bytes.size() == 7) {
    const auto mark = static_cast<std::uint8_t>(bytes[0]);
    tile.band = mark & TileKey::kMaxBand;
    if (mark < kBandMark || tile.band == 0) return std::nullopt;
    bytes.remove_prefix(1);
  }
  if (bytes.size() != 6) return std::nullopt;
  for (std::uint16_t* axis : {&tile.x, &tile.y, &tile.z}) {
    *axis = static_cast<std::uint16_t>(BigEndian(bytes.substr(0, 2)));
    bytes.remove_prefix(2);
  }
  return tile;
}

inline std::string RecordKey(Table table, const std::string& key) {
  return std::string(1, static_cast<char>(table)) + key;
}

inline std::string Number(std::uint64_t value) {
  std::string bytes;
  AppendBigEndian(value, 8, &bytes);
  return bytes;
}

// The first key behind all that begin with `prefix`; the last byte of a prefix is never 255 here.
inline std::string EndOfPrefix(std::string prefix) {
  ++prefix.back();
  return prefix;
}

}  // namespace soundmap::storage
