#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::sources {

// kGap stands for frames that were lost: its payload is a foxglove.KeyValuePair "gap" that says
// which.
enum class Sensor { kAudio, kLidar, kLaser, kOdometry, kGap };

// One sensor message, on its way to the server as it was recorded.
struct SensorFrame {
  Sensor sensor = Sensor::kAudio;
  std::int64_t log_time_ns = 0;
  std::string payload;  // a serialized Foxglove message
};

// The frames of one drive, in order: those at offsets 0, 1, 2, ... The same offset always gives the
// same frame.
class FrameSource {
 public:
  virtual ~FrameSource() = default;

  // The next frame is the one at `offset`. OutOfRange: the drive has fewer frames.
  virtual absl::Status Seek(std::int64_t offset) = 0;
  // None at the end, or while there are no more yet.
  virtual absl::StatusOr<std::optional<SensorFrame>> Next() = 0;
  // After none: whether that was the end.
  virtual bool AtEnd() const { return true; }
};

}  // namespace soundmap::sources
