#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "soundmap/v1/session_service.pb.h"

// How a session lies on the robot's disk: DIR/SESSION/session.json and MCAP segments, each named
// after the position of its first frame. Positions count what was recorded, 0, 1, 2, ...; offsets
// count what the server gets, where frames that are lost shrink to one gap record.
namespace soundmap::spool {

// Frames that are lost: on the way to the server they are one record at `offset`.
struct Gap {
  std::int64_t offset = 0;
  std::int64_t first = 0;  // positions [first, end)
  std::int64_t end = 0;
  std::int64_t from_ns = 0;  // log time of the last frame before and the first behind; 0: unknown
  std::int64_t to_ns = 0;
  std::string reason;
};

struct SessionRecord {
  v1::CreateSessionRequest request;
  std::int64_t created_ns = 0;
  std::int64_t next = 0;   // frames were recorded up to here, or farther
  bool ended = false;      // the drive is over
  bool delivered = false;  // the server has all of it in its map
  std::vector<Gap> gaps;   // in order
};

struct Segment {
  std::int64_t first = 0;  // position
  std::string path;
  std::int64_t bytes = 0;
  std::int64_t written_ns = 0;  // wall clock
};

std::string SegmentPath(const std::string& folder, std::int64_t first);
// In order; other files are left out.
absl::StatusOr<std::vector<Segment>> ListSegments(const std::string& folder);

// Whole frames in a segment, which a crash may have cut.
absl::StatusOr<std::int64_t> CountFrames(const std::string& path);

// Whole or not at all, and on the disk when it returns.
absl::Status WriteRecord(const std::string& folder, const SessionRecord& record);
// DataLoss: not such a file.
absl::StatusOr<SessionRecord> ReadRecord(const std::string& folder);

absl::Status SyncFolder(const std::string& folder);

// The position of the frame that the server gets at `offset`; of a gap's first.
std::int64_t PositionOf(const SessionRecord& record, std::int64_t offset);

}  // namespace soundmap::spool
