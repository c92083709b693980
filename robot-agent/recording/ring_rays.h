#pragma once

#include <array>
#include <cstdint>
#include <cstdlib>

namespace soundmap::recording {

// A point in whole multiples of the resolution.
using GridPoint = std::array<std::int64_t, 3>;

// Where a spinning LIDAR's next point is expected: on the ray of the last point of its ring, turned
// about z. Integers only: both ends of a transmission must come to the same.
class RingRays {
 public:
  static constexpr int kRings = 255;
  static constexpr int kMaxSteps = 15;
  static constexpr int kTurnBits = 30;
  static constexpr std::int64_t kLimit = 1 << 22;  // of an axis

  // Cosine and sine of one step of azimuth, times 2^30; see IsTurn().
  RingRays(std::int64_t turn_cos, std::int64_t turn_sin) {
    turn_[0] = {std::int64_t{1} << kTurnBits, 0};
    for (int k = 1; k <= kMaxSteps; ++k) {
      const auto [c, s] = turn_[k - 1];
      turn_[k] = {(c * turn_cos - s * turn_sin) >> kTurnBits,
                  (s * turn_cos + c * turn_sin) >> kTurnBits};
    }
  }

  // Whether the two are a cosine and a sine, so that no product overflows.
  static bool IsTurn(std::int64_t turn_cos, std::int64_t turn_sin) {
    const std::int64_t one = std::int64_t{1} << (2 * kTurnBits);
    const std::int64_t square = turn_cos * turn_cos + turn_sin * turn_sin;
    return std::abs(square - one) <= std::int64_t{1} << 34;
  }

  // The ray on which the next point of `ring` lies, as long as the last one's.
  GridPoint Ray(int ring, int steps) const {
    const GridPoint& last = last_[static_cast<std::size_t>(ring)];
    const auto [c, s] = turn_[static_cast<std::size_t>(steps)];
    return {(last[0] * c - last[1] * s) >> kTurnBits, (last[0] * s + last[1] * c) >> kTurnBits,
            last[2]};
  }
  void Keep(int ring, const GridPoint& point) { last_[static_cast<std::size_t>(ring)] = point; }

  // The axis along which the ray is longest: it is told first.
  static int MainAxis(const GridPoint& ray) {
    const auto longer = [&](int a, int b) {
      return std::abs(ray[static_cast<std::size_t>(a)]) >
             std::abs(ray[static_cast<std::size_t>(b)]);
    };
    const int xy = longer(1, 0) ? 1 : 0;
    return longer(2, xy) ? 2 : xy;
  }

  // Of the other axes, where the ray has `along` on the main one.
  static std::int64_t Across(const GridPoint& ray, int axis, int main, std::int64_t along) {
    const std::int64_t length = ray[static_cast<std::size_t>(main)];
    if (length == 0) return 0;
    const std::int64_t product = ray[static_cast<std::size_t>(axis)] * along;
    const std::int64_t half = std::abs(length) / 2;
    return (product + (product < 0 ? -half : half)) / length;
  }

 private:
  struct Turn {
    std::int64_t cos, sin;
  };
  std::array<Turn, kMaxSteps + 1> turn_;
  std::array<GridPoint, kRings> last_{};
};

}  // namespace soundmap::recording
