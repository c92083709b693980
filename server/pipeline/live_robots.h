#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/frames.h"
#include "localization/pose_estimate.h"
#include "pipeline/records.h"

namespace soundmap::pipeline {

class EventRing;

// What a robot says of itself right now.
struct LiveReport {
  bool recording = false;  // else the drive is over
  std::int64_t recorded_frames = 0;
  std::optional<frames::Odometry> odometry;
  std::shared_ptr<const frames::LaserScan> laser;  // thinned; null: none yet
  std::optional<ClockOffset> clock_offset;
};

// The newest report, and what the server makes of it.
struct LiveView {
  std::string session;
  LiveReport report;
  std::chrono::steady_clock::time_point received_at;
  // The odometry carried into the map from `localized_ns` on, as far as the session's frames were
  // localized.
  std::optional<geometry::Pose2> map_from_base;
  frames::TimeNs localized_ns = 0;
};

// The robots that report live at a site: of each the newest report, in memory alone. Of two agents
// of a robot the newer one is heard. Thread safe.
class LiveRobots {
 public:
  // Is told of every change; outlives this.
  explicit LiveRobots(EventRing* events) : events_(events) {}

  // One stream's place.
  struct Lease {
    std::int64_t epoch = 0;   // of the agent, over its streams
    std::int64_t stream = 0;  // of this one
  };
  // `epoch`: 0 of an agent that has just started. The streams before this one are over. Aborted: a
  // newer agent has reported. ResourceExhausted: too many robots.
  absl::StatusOr<Lease> Open(const std::string& robot, std::int64_t epoch, std::int64_t now_ns);
  // A report without a laser scan leaves the one before. Aborted: a later stream has been opened.
  absl::Status Report(const std::string& robot, const Lease& lease, LiveView view);
  void Close(const std::string& robot, const Lease& lease);

  std::optional<LiveView> Find(const std::string& robot) const;
  std::vector<std::pair<std::string, LiveView>> List() const;  // by name

 private:
  struct Robot {
    Lease lease;
    bool open = false;
    std::optional<LiveView> view;
  };

  EventRing* const events_;
  mutable std::mutex mutex_;
  std::map<std::string, Robot> robots_;  // guarded by mutex_
  std::int64_t streams_ = 0;             // guarded by mutex_
};

}  // namespace soundmap::pipeline
