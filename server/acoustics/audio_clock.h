#pragma once

#include <cstdint>
#include <vector>

#include "frames/frames.h"

namespace soundmap::acoustics {

// Capture time of audio samples: a robust line fitted to (sample count, stamp) pairs. The device's
// clock may differ from the robot's by up to 1000 ppm, stamps may jitter, single ones may be far
// off. One thread at a time. The state is the points, nothing else.
class AudioClock {
 public:
  struct Point {
    std::int64_t sample = 0;
    frames::TimeNs stamp_ns = 0;

    bool operator==(const Point&) const = default;
  };

  explicit AudioClock(int sample_rate_hz) : sample_rate_hz_(sample_rate_hz) {}

  // Samples in rising order. Pairs closer than 20 ms to the last one are left out; the oldest
  // beyond 512 are forgotten.
  void Add(const Point& point);
  void Restart() { Restore({}); }

  // None before the first Add().
  bool empty() const { return points_.empty(); }
  frames::TimeNs TimeOf(std::int64_t sample) const;

  const std::vector<Point>& points() const { return points_; }
  void Restore(std::vector<Point> points);

 private:
  void Fit();

  int sample_rate_hz_;
  std::vector<Point> points_;
  double drift_ = 0.0;      // seconds of the stamps per second of samples, less 1
  double offset_ns_ = 0.0;  // of the line at points_.front(), from its stamp
};

}  // namespace soundmap::acoustics
