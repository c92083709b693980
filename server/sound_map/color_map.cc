#include "sound_map/color_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>

#include "geometry/angles.h"

namespace soundmap::sound_map {
namespace {

// A colour in Oklab, where equal steps look equal: lightness, and a and b from chroma and hue.
struct Anchor {
  double at;  // log-odds / limit
  double lightness;
  double chroma;
  double hue_deg;
};

constexpr Anchor kAnchors[] = {
    {-1.00, 0.70, 0.070, 250.0}, {-0.45, 0.85, 0.040, 242.0}, {0.00, 0.970, 0.010, 95.0},
    {0.25, 0.88, 0.115, 86.0},   {0.50, 0.745, 0.165, 58.0},  {0.75, 0.570, 0.195, 28.0},
    {1.00, 0.37, 0.135, 8.0},
};

std::uint8_t ToByte(double linear) {
  const double clipped = std::clamp(linear, 0.0, 1.0);
  const double srgb =
      clipped <= 0.0031308 ? 12.92 * clipped : 1.055 * std::pow(clipped, 1.0 / 2.4) - 0.055;
  return static_cast<std::uint8_t>(std::lround(255.0 * srgb));
}

Color FromOklab(double lightness, double a, double b) {
  const double l = std::pow(lightness + 0.3963377774 * a + 0.2158037573 * b, 3.0);
  const double m = std::pow(lightness - 0.1055613458 * a - 0.0638541728 * b, 3.0);
  const double s = std::pow(lightness - 0.0894841775 * a - 1.2914855480 * b, 3.0);
  return {ToByte(4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s),
          ToByte(-1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s),
          ToByte(-0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s)};
}

Color At(double position) {
  const auto after =
      std::find_if(std::next(std::begin(kAnchors)), std::prev(std::end(kAnchors)),
                   [position](const Anchor& anchor) { return anchor.at >= position; });
  const Anchor& low = *std::prev(after);
  const Anchor& high = *after;
  const double t = (position - low.at) / (high.at - low.at);
  const auto mix = [t](double from, double to) { return from + t * (to - from); };
  const auto a = [](const Anchor& x) {
    return x.chroma * std::cos(geometry::RadFromDeg(x.hue_deg));
  };
  const auto b = [](const Anchor& x) {
    return x.chroma * std::sin(geometry::RadFromDeg(x.hue_deg));
  };
  return FromOklab(mix(low.lightness, high.lightness), mix(a(low), a(high)), mix(b(low), b(high)));
}

constexpr int kSteps = 256;

}  // namespace

Color ColorOfLogOdds(double log_odds, double limit_log_odds) {
  static const auto kTable = [] {
    std::array<Color, 2 * kSteps + 1> table;
    for (int i = -kSteps; i <= kSteps; ++i) {
      table[i + kSteps] = At(static_cast<double>(i) / kSteps);
    }
    return table;
  }();
  const double position = std::clamp(log_odds / limit_log_odds, -1.0, 1.0);
  return kTable[static_cast<int>(std::lround(position * kSteps)) + kSteps];
}

}  // namespace soundmap::sound_map
