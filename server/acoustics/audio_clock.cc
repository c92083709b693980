#include "acoustics/audio_clock.h"

#include <algorithm>
#include <cmath>

namespace soundmap::acoustics {
namespace {

constexpr std::size_t kMaxPoints = 512;
constexpr int kSlopePoints = 64;
constexpr double kMinSpacing_s = 0.02;
// The drift is taken as none until it can be told from jitter.
constexpr double kMinSpanForDrift_s = 5.0;
constexpr double kMaxDrift = 1e-3;

double Median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

void AudioClock::Add(const Point& point) {
  if (!points_.empty() && point.sample - points_.back().sample < kMinSpacing_s * sample_rate_hz_) {
    return;
  }
  if (points_.size() >= kMaxPoints) points_.erase(points_.begin());
  points_.push_back(point);
  Fit();
}

void AudioClock::Restore(std::vector<Point> points) {
  points_ = std::move(points);
  Fit();
}

frames::TimeNs AudioClock::TimeOf(std::int64_t sample) const {
  const double elapsed_ns =
      static_cast<double>(sample - points_.front().sample) * 1e9 / sample_rate_hz_ * (1.0 + drift_);
  return points_.front().stamp_ns + std::llround(elapsed_ns + offset_ns_);
}

void AudioClock::Fit() {
  drift_ = 0.0;
  offset_ns_ = 0.0;
  if (points_.empty()) return;
  // Of each point, from the first one: the time by samples, and by how much the stamp is ahead of
  // it.
  std::vector<double> elapsed_ns;
  std::vector<double> ahead_ns;
  for (const Point& point : points_) {
    elapsed_ns.push_back(static_cast<double>(point.sample - points_.front().sample) * 1e9 /
                         sample_rate_hz_);
    ahead_ns.push_back(static_cast<double>(point.stamp_ns - points_.front().stamp_ns) -
                       elapsed_ns.back());
  }
  const std::size_t count = points_.size();
  if (elapsed_ns.back() * 1e-9 >= kMinSpanForDrift_s) {
    // Theil and Sen: the median of the slopes between all pairs of points.
    const std::size_t stride = (count + kSlopePoints - 1) / kSlopePoints;
    std::vector<double> slopes;
    for (std::size_t b = stride; b < count; b += stride) {
      for (std::size_t a = 0; a < b; a += stride) {
        slopes.push_back((ahead_ns[b] - ahead_ns[a]) / (elapsed_ns[b] - elapsed_ns[a]));
      }
    }
    if (!slopes.empty()) drift_ = std::clamp(Median(slopes), -kMaxDrift, kMaxDrift);
  }
  for (std::size_t i = 0; i < count; ++i) ahead_ns[i] -= drift_ * elapsed_ns[i];
  offset_ns_ = Median(ahead_ns);
}

}  // namespace soundmap::acoustics
