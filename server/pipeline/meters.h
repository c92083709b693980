#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>

#include "pipeline/stage_times.h"

namespace soundmap::pipeline {

// How long something took, counted by size. Thread safe.
class LagHistogram {
 public:
  static constexpr std::array<std::chrono::milliseconds, 10> kBounds = {
      std::chrono::milliseconds(10),   std::chrono::milliseconds(20),
      std::chrono::milliseconds(50),   std::chrono::milliseconds(100),
      std::chrono::milliseconds(200),  std::chrono::milliseconds(300),
      std::chrono::milliseconds(500),  std::chrono::milliseconds(1000),
      std::chrono::milliseconds(2000), std::chrono::milliseconds(5000)};

  void Add(std::chrono::nanoseconds lag) {
    std::size_t bucket = 0;
    while (bucket < kBounds.size() && lag > kBounds[bucket]) ++bucket;
    counts_[bucket].fetch_add(1, std::memory_order_relaxed);
    sum_ns_.fetch_add(lag.count(), std::memory_order_relaxed);
  }
  // Above the bound before, up to kBounds[bucket]; the last has no bound.
  std::int64_t count(std::size_t bucket) const {
    return counts_[bucket].load(std::memory_order_relaxed);
  }
  std::chrono::nanoseconds sum() const { return std::chrono::nanoseconds(sum_ns_.load()); }

 private:
  std::array<std::atomic<std::int64_t>, kBounds.size() + 1> counts_{};
  std::atomic<std::int64_t> sum_ns_ = 0;
};

// What a server counts of its work, whoever reads it. Thread safe.
struct Meters {
  StageTimes stages;
  std::atomic<std::int64_t> received_bytes = 0;   // of the messages that robots have sent
  std::atomic<std::int64_t> lost_frames = 0;      // that robots reported as lost
  std::atomic<std::int64_t> replayed_frames = 0;  // whose work was done again at the start
  LagHistogram durable_lag;                       // from a frame's arrival to the disk
  std::atomic<std::int64_t> bytes_in_flight = 0;  // of frames that wait for the disk
  std::atomic<std::int64_t> backlog_frames = 0;   // on the disk, that wait for the map
  std::atomic<std::int64_t> streams = 0;          // of robots, open now
  std::atomic<std::int64_t> live_streams = 0;     // of robots, open now
  std::atomic<std::int64_t> watches = 0;          // open now
};

}  // namespace soundmap::pipeline
