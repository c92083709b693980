#pragma once

#include <cstdint>

namespace soundmap::sound_map {

struct Color {
  std::uint8_t red = 0;
  std::uint8_t green = 0;
  std::uint8_t blue = 0;

  bool operator==(const Color&) const = default;
};

// Log-odds up to this are told apart by colour.
inline constexpr double kColorLimit_log_odds = 20.0;

// Near white at 0, through amber and red to dark wine at +limit, through pale to slate blue at
// -limit. Lightness falls evenly on either side, and further for sound than for silence, so that
// sources stand out, also without colour vision and in grey print.
Color ColorOfLogOdds(double log_odds, double limit_log_odds = kColorLimit_log_odds);

}  // namespace soundmap::sound_map
