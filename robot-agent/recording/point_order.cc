#include "recording/point_order.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace soundmap::recording {
namespace {

bool IsNowhere(const GridPoint& point) { return point[0] == 0 && point[1] == 0 && point[2] == 0; }

// The rings of a spinning LIDAR, told by the elevations that many points share.
class Rings {
 public:
  // One ring when the points do not lie on rings.
  explicit Rings(std::span<const GridPoint> points) : ring_of_bin_(kBins, 0) {
    std::vector<int> count(kBins, 0);
    for (const GridPoint& point : points) ++count[BinOf(point)];
    const int enough = std::max<int>(2, static_cast<int>(points.size() / 8192));
    std::vector<int> ring_end;  // the bin behind the ring
    std::vector<int> ring_begin;
    for (int bin = 0; bin < static_cast<int>(kBins); ++bin) {
      if (count[static_cast<std::size_t>(bin)] < enough) continue;
      if (!ring_end.empty() && bin - ring_end.back() <= 1) {
        ring_end.back() = bin + 1;
      } else {
        ring_begin.push_back(bin);
        ring_end.push_back(bin + 1);
      }
    }
    if (ring_begin.size() > RingRays::kRings || ring_begin.empty()) return;
    std::size_t ring = 0;
    for (int bin = 0; bin < static_cast<int>(kBins); ++bin) {
      while (ring + 1 < ring_begin.size() && bin - ring_end[ring] > ring_begin[ring + 1] - bin) {
        ++ring;
      }
      ring_of_bin_[static_cast<std::size_t>(bin)] = static_cast<std::uint8_t>(ring);
    }
  }

  std::uint8_t Of(const GridPoint& point) const { return ring_of_bin_[BinOf(point)]; }

 private:
  static constexpr std::size_t kBins = 1 << 13;  // 0.38 mrad each

  static std::size_t BinOf(const GridPoint& point) {
    const auto x = static_cast<float>(point[0]);
    const auto y = static_cast<float>(point[1]);
    const float elevation_rad = std::atan2(static_cast<float>(point[2]), std::sqrt(x * x + y * y));
    const auto bin = static_cast<int>((elevation_rad * std::numbers::inv_pi_v<float> + 0.5f) *
                                      static_cast<float>(kBins));
    return static_cast<std::size_t>(std::clamp(bin, 0, static_cast<int>(kBins) - 1));
  }

  std::vector<std::uint8_t> ring_of_bin_;
};

}  // namespace

PointOrder OrderOf(std::span<const GridPoint> points, bool in_rings) {
  PointOrder order;
  order.ring.assign(points.size(), 0);
  order.steps.assign(points.size(), 0);
  std::vector<float> turn_rad(points.size(), 0.0f);
  if (in_rings) {
    const Rings rings(points);
    float last_rad[RingRays::kRings] = {};
    bool has_last[RingRays::kRings] = {};
    std::vector<float> turns_rad;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (IsNowhere(points[i])) continue;
      const std::uint8_t ring = rings.Of(points[i]);
      order.ring[i] = ring;
      const float azimuth_rad =
          std::atan2(static_cast<float>(points[i][1]), static_cast<float>(points[i][0]));
      if (has_last[ring]) {
        turn_rad[i] =
            std::remainder(azimuth_rad - last_rad[ring], 2.0f * std::numbers::pi_v<float>);
        turns_rad.push_back(turn_rad[i]);
      }
      has_last[ring] = true;
      last_rad[ring] = azimuth_rad;
    }
    if (!turns_rad.empty()) {
      const auto middle = turns_rad.begin() + static_cast<std::ptrdiff_t>(turns_rad.size() / 2);
      std::nth_element(turns_rad.begin(), middle, turns_rad.end());
      // The median is one beam's; those near it together say it better.
      double sum_rad = 0.0;
      int near = 0;
      for (const float turn : turns_rad) {
        if (std::abs(turn - *middle) > 0.25f * std::abs(*middle)) continue;
        sum_rad += turn;
        ++near;
      }
      order.turn_rad = near > 0 ? sum_rad / near : 0.0;
    }
    for (std::size_t i = 0; i < points.size() && order.turn_rad != 0.0; ++i) {
      const double steps = std::nearbyint(turn_rad[i] / order.turn_rad);
      if (steps > 0.0 && steps <= RingRays::kMaxSteps) {
        order.steps[i] = static_cast<std::uint8_t>(steps);
      }
    }
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (IsNowhere(points[i])) order.ring[i] = kNoReturnRing;
  }
  return order;
}

}  // namespace soundmap::recording
