#pragma once

#include <string>

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

inline std::string TileKeyBytes(const std::string& site, const TileKey& tile) {
  std::string key = SiteKey(site);
  for (const std::uint16_t axis : {tile.x, tile.y, tile.z}) AppendBigEndian(axis, 2, &key);
  return key;
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
