#pragma once

#include <vector>

namespace soundmap::acoustics {

// Real, orthonormal spherical harmonics: Y_l0 = P_l0(z), Y_lm = P_lm(z) cos(m azimuth), Y_l-m =
// P_lm(z) sin(m azimuth), with all factors in P and no sign (-1)^m.

constexpr int LegendreIndex(int l, int m) { return l * (l + 1) / 2 + m; }

// P_lm(z) for 0 <= m <= l <= degree, at LegendreIndex(l, m).
std::vector<double> NormalizedLegendre(int degree, double z);

// Spherical Bessel functions j_0(x) .. j_degree(x), x >= 0.
std::vector<double> SphericalBessel(int degree, double x);

}  // namespace soundmap::acoustics
