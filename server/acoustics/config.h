#pragma once

#include <optional>
#include <variant>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "geometry/angles.h"
#include "geometry/directions.h"

namespace soundmap::acoustics {

// Candidate directions spread evenly over the whole sphere.
struct EqualAreaGrid {
  double spacing_rad = geometry::RadFromDeg(2.0);

  bool operator==(const EqualAreaGrid&) const = default;
};

// Candidate directions by azimuth and elevation, limits included. The defaults are section VI's.
struct SectorGrid {
  double azimuth_min_rad = geometry::RadFromDeg(-45.0);
  double azimuth_max_rad = geometry::RadFromDeg(15.0);
  double elevation_min_rad = geometry::RadFromDeg(0.0);
  double elevation_max_rad = geometry::RadFromDeg(75.0);
  double step_rad = geometry::RadFromDeg(1.0);

  bool operator==(const SectorGrid&) const = default;
};

// Eq. (6) with the values of section VI. T1 and T2 are absolute powers, so they depend on the
// number of bins in the band.
struct DoubleThreshold {
  double t1 = 20.0;
  double t2 = 30.0;
  double p_min = 0.1;
  double p_med = 0.5;
  double p_max = 0.999;  // section IV has 0.9

  bool operator==(const DoubleThreshold&) const = default;
};

// Deviation from eq. (6): only peaks of the power speak for a source. The noise floor is the median
// of S over the directions, its spread the standard deviation of the normal distribution with the
// same distance from the lower quartile to the median; both of the power that is left when the peak
// at hand is taken off, so that the side lobes of a strong source do not hide weak ones. The
// incoherent spread is what noise that is independent at each microphone leaves by theory; it
// decides where nothing is to be heard: white noise then gives a peak in less than 1 scan of 500.
struct PeakEvidence {
  double threshold_spreads = 5.0;             // a peak stands this many spreads above the floor
  double threshold_incoherent_spreads = 5.0;  // and this many incoherent spreads
  // When no such peak is left, local maxima that stand less high count, too: each says little, but
  // those of a faint source come again from the same place, and those of noise do not.
  double faint_spreads = 3.0;
  double faint_incoherent_spreads = 4.0;
  int max_peaks = 10;
  double peak_radius_rad = geometry::RadFromDeg(3.0);
  double undecided_radius_rad = geometry::RadFromDeg(10.0);
  double p_peak = 0.9;       // within peak_radius_rad of a peak; see PeakFinder::Likelihood()
  double p_undecided = 0.5;  // within undecided_radius_rad
  double p_rest = 0.4;

  bool operator==(const PeakEvidence&) const = default;
};

// What section IV sets eq. (6) against, after its refs. [7] and [9]: a likelihood that grows with
// the power, from p_min in the direction of the least power of the scan to p_max in that of the
// most.
struct ScaledPower {
  double p_min = 0.05;
  double p_max = 0.95;

  bool operator==(const ScaledPower&) const = default;
};

// Sections III and IV. A default-constructed one is the profile `default`.
struct AcousticsConfig {
  static AcousticsConfig Default() { return {}; }
  static AcousticsConfig Paper();

  double window_s =
      0.025;  // W over the sample rate, rounded to an even number of samples: 400 at 16 kHz
  std::optional<int> window_samples;  // W itself, at any rate, in place of window_s; even
  int frames_per_scan = 10;           // K
  double f_min_hz = 1000.0;           // eq. (5), inclusive
  // Eq. (5), inclusive; above half the sample rate there is nothing. Section VI has 3000 Hz. Up to
  // 5000 Hz a beam is narrower, and more of what hisses is heard.
  double f_max_hz = 5000.0;
  double speed_of_sound_mps = 343.0;
  std::variant<EqualAreaGrid, SectorGrid> grid;
  std::variant<PeakEvidence, DoubleThreshold, ScaledPower> evidence;

  absl::Status Validate() const;
  geometry::DirectionGrid MakeGrid() const;  // of a valid configuration

  bool operator==(const AcousticsConfig&) const = default;
};

// Section III's time and frequency axes at one sample rate.
struct FrameLayout {
  int sample_rate_hz = 0;
  int window_samples = 0;   // W
  int frames_per_scan = 0;  // K
  int first_bin = 0;        // of the band; bin b lies at b * sample_rate_hz / W
  int bins = 0;             // B

  int hop_samples() const { return window_samples / 2; }
  int scan_period_samples() const { return frames_per_scan * hop_samples(); }
  int scan_samples() const { return scan_period_samples() + hop_samples(); }
  double bin_hz(int b) const {
    return static_cast<double>(first_bin + b) * sample_rate_hz / window_samples;
  }

  // InvalidArgument: an invalid configuration, a sample rate outside 8 to 192 kHz, no bin in the
  // part of the band below half the sample rate.
  static absl::StatusOr<FrameLayout> Create(const AcousticsConfig& config, int sample_rate_hz);
};

}  // namespace soundmap::acoustics
