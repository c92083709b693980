#include "acoustics/spherical_harmonics.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"

namespace soundmap::acoustics {

std::vector<double> NormalizedLegendre(int degree, double z) {
  std::vector<double> p(LegendreIndex(degree, degree) + 1);
  const double across = std::sqrt(std::max(0.0, 1.0 - z * z));
  double sectoral = std::sqrt(1.0 / (4.0 * geometry::kPi));
  for (int m = 0; m <= degree; ++m) {
    if (m > 0) sectoral *= std::sqrt((m == 1 ? 2.0 : 1.0) * (2.0 * m + 1.0) / (2.0 * m)) * across;
    double before = 0.0;
    double now = sectoral;
    p[LegendreIndex(m, m)] = now;
    double before_factor = 0.0;
    for (int l = m + 1; l <= degree; ++l) {
      const double factor = std::sqrt((4.0 * l * l - 1.0) /
                                      (static_cast<double>(l) * l - static_cast<double>(m) * m));
      const double next = factor * (z * now - before_factor * before);
      before = now;
      now = next;
      before_factor = 1.0 / factor;
      p[LegendreIndex(l, m)] = now;
    }
  }
  return p;
}

std::vector<double> SphericalBessel(int degree, double x) {
  std::vector<double> j(degree + 1, 0.0);
  constexpr double kNearZero = 1e-8;
  if (x < kNearZero) {
    j[0] = 1.0;
    if (degree > 0) j[1] = x / 3.0;
    return j;
  }
  // Downwards, where the recurrence is stable; the start is arbitrary and the scale follows from
  // the sum over l of (2 l + 1) j_l^2 = 1.
  const int start = std::max(degree, static_cast<int>(x)) + 30 + static_cast<int>(x / 10.0);
  double above = 0.0;
  double now = 1e-30;
  double norm = 0.0;
  for (int l = start; l >= 0; --l) {
    norm += (2.0 * l + 1.0) * now * now;
    if (l <= degree) j[l] = now;
    const double below = (2.0 * l + 1.0) / x * now - above;
    above = now;
    now = below;
    constexpr double kLarge = 1e100;
    if (std::abs(now) > kLarge) {
      now /= kLarge;
      above /= kLarge;
      norm /= kLarge * kLarge;
      for (int k = std::max(l, 0); k <= degree; ++k) j[k] /= kLarge;
    }
  }
  // The sign is that of the larger of j_0 and j_1 = sin(x) / x^2 - cos(x) / x.
  const double j0 = std::sin(x) / x;
  const double j1 = std::sin(x) / (x * x) - std::cos(x) / x;
  // After the loop, `above` is proportional to j_0.
  const double reference = std::abs(j0) > std::abs(j1) || degree == 0 ? j0 * above : j1 * j[1];
  const double scale = (reference < 0.0 ? -1.0 : 1.0) / std::sqrt(norm);
  for (double& value : j) value *= scale;
  return j;
}

}  // namespace soundmap::acoustics
