#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <variant>

#include "soundmap/resources.h"
#include "soundmap/sound.h"

namespace soundmap {

struct WatchRequest {
  std::string site;
  bool sound_sources = false;
  bool robots = false;
  bool audio_scans = false;
  std::string resume_token;  // of the last event seen; empty: from the present state
  std::string band;          // of the sources and scans; empty: that of the site's profile
};

struct RemovedSoundSource {
  std::string id;
};
// The newest that a live robot said; the robot's other fields are told of by Robot.
struct LiveRobot {
  std::string robot;
  std::optional<LiveView> live;  // none: it is live no more
  std::optional<ClockOffset> clock_offset;
};
// All of the present state has been told; what follows are changes.
struct SnapshotComplete {};
// Nothing happened; the connection is alive.
struct Heartbeat {};
// Events were lost: forget what was told; the present state follows.
struct Resync {};

struct WatchEvent {
  std::int64_t revision = 0;
  std::string resume_token;
  std::variant<Heartbeat, SoundSource, RemovedSoundSource, Robot, AudioScan, SnapshotComplete,
               Resync, SoundSourceEvent, LiveRobot>
      event;
};

// Returns whether to go on watching.
using WatchCallback = std::function<bool(const WatchEvent&)>;

}  // namespace soundmap
