#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

// Compiled for the processor of the caller.
#define SOUNDMAP_INLINE inline __attribute__((always_inline))

namespace soundmap::ray_casting {

// Cells of directions: bands of elevation, cut by azimuth. Both are told by ratios that grow with
// the angle, by 0.5 to 1 a radian: no trigonometry.
class SphereCells {
 public:
  static constexpr int kBands = 96;
  static constexpr int kMaxCells = 1 << 14;

  // Neighbouring cells of one band; points in the order of their cells stand in a row there.
  struct Row {
    std::uint16_t begin;
    std::uint16_t end;
  };

  static const SphereCells& Get();

  int size() const { return first_[kBands]; }
  // The cells that can hold a direction within the angle of the unit vector; kRounding allows for
  // vectors in single precision.
  void AppendRowsWithin(const Eigen::Vector3f& v, float angle_rad, std::vector<Row>* rows) const;

  // -1 at -z, 0 in the x-y plane, 1 at z; `across` is the length of x and y.
  SOUNDMAP_INLINE static float ElevationRatio(float z, float across) {
    return z / (std::abs(z) + across + std::numeric_limits<float>::min());
  }
  // 0 at -x, 1 at -y, 2 at x, up to 4: the end of a band lies behind the array.
  SOUNDMAP_INLINE static float AzimuthRatio(float x, float y) {
    const float t = x / (std::abs(x) + std::abs(y) + std::numeric_limits<float>::min());
    return y < 0.0f ? 1.0f + t : 3.0f - t;
  }
  SOUNDMAP_INLINE static float BandRatio(float elevation_ratio) {
    return (elevation_ratio + 1.0f) * (kBands / 2);
  }
  SOUNDMAP_INLINE int CellOf(int band, float azimuth_ratio) const {
    band = std::min(band, kBands - 1);
    return std::min(first_[band] + static_cast<int>(azimuth_ratio * per_ratio_[band]),
                    first_[band + 1] - 1);
  }

  // Ratios and unit vectors are this exact.
  static constexpr float kRounding = 2e-6f;

 private:
  SphereCells();

  std::array<std::int32_t, kBands + 1> first_;  // cell of each band
  std::array<float, kBands> per_ratio_;         // cells a unit of azimuth ratio
};

}  // namespace soundmap::ray_casting
