#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "acoustics/likelihood_scan.h"
#include "localization/pose_estimate.h"
#include "pipeline/band.h"
#include "pipeline/live_robots.h"
#include "sound_map/source_register.h"

namespace soundmap::pipeline {

// An audio scan that entered the map.
struct AudioScanInfo {
  std::string robot;
  std::string session;
  frames::TimeNs time_ns = 0;  // t_k, the middle of the scan
  localization::PoseEstimate pose;
  double noise_floor = 0.0;
  std::vector<acoustics::Peak> peaks;
  std::int64_t end_points = 0;
  std::vector<sound_map::HeardPeak> heard;
  std::optional<sound_map::ArrayPlane> array_plane;
  std::optional<double> full_scale_spl_db;  // of the microphones, see frames::Calibration
  std::optional<Eigen::Vector3d> array_in_map_m;
  std::uint8_t band = kMainBand;  // number of the map that it entered
};

// A robot that has had a session here, or reports live.
struct RobotInfo {
  std::string robot;
  std::string site;
  std::string session;  // its newest
  bool streaming = false;
  std::optional<localization::PoseEstimate> pose;
  frames::TimeNs last_seen_ns = 0;  // capture time of its newest processed frame
  std::int64_t lost_frames = 0;     // in that session, before they could be sent
  std::optional<LiveView> live;
  std::optional<ClockOffset> clock_offset;
};

// LiveRobots has something newer of this one, or nothing more.
struct LiveChanged {
  std::string robot;
};

// A source of one of the site's maps is new or has changed, is there no more, or something happened
// to it.
struct SourceChanged {
  std::uint8_t band = kMainBand;
  sound_map::RegisteredSource source;
};
struct SourceRemoved {
  std::uint8_t band = kMainBand;
  std::uint64_t id = 0;
};
struct SourceHappened {
  std::uint8_t band = kMainBand;
  sound_map::SourceEvent event;
};

using Event = std::variant<SourceChanged, SourceRemoved, SourceHappened, RobotInfo, AudioScanInfo,
                           LiveChanged>;

// What happened at one site, newest last: a ring of bounded length, so that a slow reader can fall
// out of it but never holds anybody up. Thread safe.
class EventRing {
 public:
  explicit EventRing(std::size_t capacity = 4096) : capacity_(capacity) {}

  void Publish(Event event);

  struct Batch {
    std::vector<Event> events;
    std::int64_t next = 0;  // read on from here
    bool lost = false;      // events between `from` and the first of these are gone
  };
  Batch Read(std::int64_t from, std::size_t max_events) const;
  std::int64_t next() const;

  // `wake` is called after every Publish() until Unsubscribe() has returned; it must not block or
  // call back into the ring.
  int Subscribe(std::function<void()> wake);
  void Unsubscribe(int subscription);

 private:
  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::deque<Event> events_;                    // guarded by mutex_
  std::int64_t first_ = 0;                      // guarded by mutex_; number of events_.front()
  std::map<int, std::function<void()>> wakes_;  // guarded by mutex_
  int subscriptions_ = 0;                       // guarded by mutex_
};

}  // namespace soundmap::pipeline
