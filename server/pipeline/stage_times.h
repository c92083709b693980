#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>

namespace soundmap::pipeline {

// What the processor's time goes to while robots stream.
enum class Stage : std::uint8_t {
  kReceive,   // checksum and decoding of what came, and its way into the queue
  kLog,       // writing and syncing the session logs
  kLocalize,  // odometry and laser scans to poses
  kSpectra,   // audio blocks to spectra
  kPower,     // spectra to the power of every direction
  kEvidence,  // power to likelihoods
  kCast,      // likelihoods to end points
  kCommit,    // journal, trajectory and offsets into the store
  kMap,       // end points into the map
  kState,     // snapshots of a session's state
  kSession,   // what else a session does with its frames
  kSources,   // sound sources for those who watch
};
inline constexpr int kStages = 12;

const char* NameOf(Stage stage);

// The processor time of each stage since the server started. Thread safe.
class StageTimes {
 public:
  void Add(Stage stage, std::chrono::nanoseconds cpu_time) {
    cpu_ns_[static_cast<std::size_t>(stage)].fetch_add(cpu_time.count(), std::memory_order_relaxed);
  }
  std::chrono::nanoseconds cpu_time(Stage stage) const {
    return std::chrono::nanoseconds(
        cpu_ns_[static_cast<std::size_t>(stage)].load(std::memory_order_relaxed));
  }

 private:
  std::array<std::atomic<std::int64_t>, kStages> cpu_ns_{};
};

// Measures the stages of one piece of work, on one thread. A thread's processor time costs a system
// call, the time of day next to nothing: the laps are taken by the latter and scaled to the former
// at the end, so that what other threads did meanwhile does not count. It feeds figures and never
// results.
class StageClock {
 public:
  explicit StageClock(StageTimes* times) : times_(times) {}  // null: measures nothing

  void Start();
  // What was done since Start() or the last Lap() belongs to `stage`. Nothing before Start().
  void Lap(Stage stage);
  // The rest belongs to `stage`, and all goes to the times.
  void Stop(Stage stage);

 private:
  StageTimes* const times_;
  bool running_ = false;
  std::chrono::steady_clock::time_point lap_;
  std::chrono::nanoseconds cpu_at_start_{};
  std::array<std::chrono::nanoseconds, kStages> laps_{};
};

}  // namespace soundmap::pipeline
