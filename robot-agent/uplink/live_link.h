#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <string>
#include <thread>

#include "soundmap/v1/live_service.grpc.pb.h"
#include "sources/frame_source.h"
#include "uplink/clock_filter.h"

namespace soundmap::uplink {

struct LiveOptions {
  std::string token;  // bearer token; empty: none
  std::string robot;  // resource names
  std::string session;
  std::chrono::milliseconds interval{200};  // between two reports, if the link carries them
  // No answer for so long, and another connection is tried.
  std::chrono::milliseconds answer_timeout{3'000};
  std::chrono::milliseconds max_backoff{1'000};  // a random part of it is waited before
  std::chrono::milliseconds hold{30'000};  // after the server has refused, or hears a newer agent
};

struct RobotClocks {
  std::function<std::int64_t()> monotonic_ns;  // never set, also counts while the robot sleeps
  std::function<std::int64_t()> wall_ns;       // that frames' times are of
};

// A report of where the robot is and what its LRF sees, from the frame that was noted last; the
// rest is for who sends it.
class LiveScene {
 public:
  // Odometry and laser scans; others are ignored.
  void Note(const sources::SensorFrame& frame);
  // What is new since the last call, the odometry always.
  v1::LiveReport Take();

 private:
  std::mutex mutex_;
  std::string odometry_;  // guarded by mutex_; serialized, as the next
  std::string laser_;     // guarded by mutex_; empty: none since the last call
};

// Tells the server what the robot does right now and compares clocks with it, on a thread and on
// connections of its own, so that frames that wait hold up neither. One report is on its way at a
// time; what the link does not carry is not sent.
class LiveLink {
 public:
  using OpenChannel = std::function<std::shared_ptr<grpc::Channel>()>;

  // `open` gives a channel with a connection of its own each time. `say` takes sentences about a
  // server that refuses; one that cannot be reached is no news.
  LiveLink(LiveOptions options, OpenChannel open, RobotClocks clocks, std::mt19937_64 random,
           std::function<void(const std::string&)> say);
  ~LiveLink();  // ends it

  // On any thread.
  void Note(const sources::SensorFrame& frame) { scene_.Note(frame); }
  void SetDrive(v1::DriveState state, std::int64_t recorded_frames);

 private:
  void Run();
  // Until the connection fails or is refused.
  grpc::Status Talk();
  v1::LiveReport MakeReport();
  // Whether to stop, at the latest after `time`.
  bool Stopped(std::chrono::milliseconds time);
  void SetContext(grpc::ClientContext* context);

  const LiveOptions options_;
  const OpenChannel open_;
  const RobotClocks clocks_;
  const std::function<void(const std::string&)> say_;
  LiveScene scene_;

  // The thread's own.
  std::mt19937_64 random_;
  ClockFilter clock_filter_;
  std::int64_t epoch_ = 0;
  std::string said_;  // the last refusal

  std::mutex mutex_;
  std::condition_variable stop_;
  // Guarded by mutex_.
  bool stopped_ = false;
  grpc::ClientContext* context_ = nullptr;  // of the call that runs
  v1::DriveState drive_state_ = v1::DRIVE_STATE_RECORDING;
  std::int64_t recorded_frames_ = 0;

  std::thread thread_;
};

}  // namespace soundmap::uplink
