#include "frames/echo_ripple.h"

#include <cmath>
#include <numbers>
#include <utility>

namespace soundmap::frames {
namespace {

// At half a wave from bin to bin every detour looks like a shorter one.
constexpr double kMostWavesPerBin = 0.4;

}  // namespace

double EchoRipple::Fit(double detour_m) const {
  const double waves_per_bin = waves_per_m * detour_m;
  if (values.empty() || !(std::abs(waves_per_bin) <= kMostWavesPerBin)) return 0.0;
  // cos((b + 1) x) = 2 cos(x) cos(b x) - cos((b - 1) x)
  const double step_rad = 2.0 * std::numbers::pi * waves_per_bin;
  const double twice = 2.0 * std::cos(step_rad);
  double before = std::cos((first_bin - 1) * step_rad);
  double now = std::cos(first_bin * step_rad);
  double sum = 0.0;
  for (const std::int8_t value : values) {
    sum += value * now;
    before = std::exchange(now, twice * now - before);
  }
  return sum / kValuesPerSigma / std::sqrt(0.5 * static_cast<double>(values.size()));
}

}  // namespace soundmap::frames
