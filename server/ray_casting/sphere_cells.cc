#include "ray_casting/sphere_cells.h"

namespace soundmap::ray_casting {

SphereCells::SphereCells() {
  first_[0] = 0;
  for (int band = 0; band < kBands; ++band) {
    // The wider edge.
    const double low = 2.0 * band / kBands - 1.0;
    const double ratio = low < 0.0 ? std::max(0.0, -low - 2.0 / kBands) : low;
    const double circumference = (1.0 - ratio) / std::hypot(ratio, 1.0 - ratio);
    const int quarter = std::max(1, static_cast<int>(std::lround(0.5 * kBands * circumference)));
    per_ratio_[band] = static_cast<float>(quarter);
    first_[band + 1] = first_[band] + 4 * quarter;
  }
}

const SphereCells& SphereCells::Get() {
  static const SphereCells cells;
  return cells;
}

void SphereCells::AppendRowsWithin(const Eigen::Vector3f& v, float angle_rad,
                                   std::vector<Row>* rows) const {
  const float across = std::hypot(v.x(), v.y());  // cosine of the elevation
  const float elevation_ratio = ElevationRatio(v.z(), across);
  const float azimuth_ratio = AzimuthRatio(v.x(), v.y());
  const auto band_of = [](float ratio) {
    return std::clamp(static_cast<int>(BandRatio(ratio)), 0, kBands - 1);
  };
  const float elevation_reach = angle_rad + kRounding;
  const int low = band_of(elevation_ratio - elevation_reach);
  const int high = band_of(elevation_ratio + elevation_reach);
  // Points within the angle lie within asin(sin(angle) / cos(elevation)) of azimuth, unless a pole
  // is within the angle as well.
  const bool pole = angle_rad >= across;
  const float sine = pole ? 1.0f : angle_rad / across;
  const float azimuth_reach = sine * (1.0f + 0.5708f * sine * sine) + kRounding;
  const auto append = [rows](int begin, int end) {
    rows->push_back({static_cast<std::uint16_t>(begin), static_cast<std::uint16_t>(end)});
  };
  for (int band = low; band <= high; ++band) {
    const int first = first_[band];
    const int cells = first_[band + 1] - first;
    // Counted from a turn before, so that it rounds down.
    const int from =
        static_cast<int>((azimuth_ratio - azimuth_reach) * per_ratio_[band] + cells) - cells;
    const int to = static_cast<int>((azimuth_ratio + azimuth_reach) * per_ratio_[band]);
    if (pole || to - from + 1 >= cells) {
      append(first, first + cells);
      continue;
    }
    append(first + std::max(from, 0), first + std::min(to + 1, cells));
    if (from < 0) append(first + cells + from, first + cells);
    if (to >= cells) append(first, first + to + 1 - cells);
  }
}

}  // namespace soundmap::ray_casting
