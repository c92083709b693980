#pragma once

#include <cstdint>
#include <vector>

namespace soundmap::frames {

// The ripple that an echo leaves in the spectrum of a sound. What arrives once more by way of a
// reflecting surface, on a path longer by a detour d, adds to itself where d is a whole number of
// waves, and takes from itself between (Lloyd's mirror), for a reflection r:
//   |1 + r exp(-2 pi i f d / c)|^2 = 1 + r^2 + 2 r cos(2 pi f d / c).
struct EchoRipple {
  static constexpr double kValuesPerSigma = 24.0;

  double waves_per_m = 0.0;  // of bin 1: its frequency over the speed of sound
  int first_bin = 0;
  // By bin: the logarithm of the power less its mean around there, in 24ths of its standard
  // deviation. Empty: not known.
  std::vector<std::int8_t> values;

  // How well an echo with this detour fits, in standard deviations of what sound without any echo
  // gives; positive: it does. 0: not known, or too late for the bins to tell.
  double Fit(double detour_m) const;

  bool operator==(const EchoRipple&) const = default;
};

}  // namespace soundmap::frames
