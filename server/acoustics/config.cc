#include "acoustics/config.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"

namespace soundmap::acoustics {
namespace {

using geometry::kPi;

constexpr int kMaxWindowSamples = 1 << 16;
constexpr double kMaxScanDuration_s = 10.0;
constexpr double kMinGridStep_rad = geometry::RadFromDeg(0.25);

absl::Status CheckRange(const char* name, double value, double min, double max) {
  if (value >= min && value <= max) return absl::OkStatus();  // false for NaN
  return absl::InvalidArgumentError(
      absl::StrCat("acoustics.", name, " is ", value, "; it must be from ", min, " to ", max));
}

absl::Status CheckProbability(const char* name, double value) {
  if (value > 0.0 && value < 1.0) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("acoustics.", name, " is ", value, "; it must lie between 0 and 1"));
}

struct GridCheck {
  absl::Status operator()(const EqualAreaGrid& grid) const {
    return CheckRange("grid.spacing_rad", grid.spacing_rad, kMinGridStep_rad, 0.5);
  }
  absl::Status operator()(const SectorGrid& grid) const {
    absl::Status status;
    status.Update(CheckRange("grid.step_rad", grid.step_rad, kMinGridStep_rad, 0.5));
    status.Update(CheckRange("grid.azimuth_min_rad", grid.azimuth_min_rad, -2.0 * kPi, 2.0 * kPi));
    status.Update(CheckRange("grid.azimuth_max_rad", grid.azimuth_max_rad, grid.azimuth_min_rad,
                             grid.azimuth_min_rad + 2.0 * kPi));
    status.Update(
        CheckRange("grid.elevation_min_rad", grid.elevation_min_rad, -kPi / 2.0, kPi / 2.0));
    status.Update(CheckRange("grid.elevation_max_rad", grid.elevation_max_rad,
                             grid.elevation_min_rad, kPi / 2.0));
    return status;
  }
};

struct EvidenceCheck {
  absl::Status operator()(const DoubleThreshold& evidence) const {
    absl::Status status;
    status.Update(CheckRange("t1", evidence.t1, 0.0, 1e9));
    status.Update(CheckRange("t2", evidence.t2, evidence.t1, 1e9));
    status.Update(CheckProbability("p_min", evidence.p_min));
    status.Update(CheckProbability("p_med", evidence.p_med));
    status.Update(CheckProbability("p_max", evidence.p_max));
    return status;
  }
  absl::Status operator()(const ScaledPower& evidence) const {
    absl::Status status;
    status.Update(CheckProbability("p_min", evidence.p_min));
    status.Update(CheckProbability("p_max", evidence.p_max));
    if (evidence.p_min > evidence.p_max) {
      status.Update(
          absl::InvalidArgumentError("acoustics.p_min must not be above acoustics.p_max"));
    }
    return status;
  }
  absl::Status operator()(const PeakEvidence& evidence) const {
    absl::Status status;
    status.Update(CheckRange("threshold_spreads", evidence.threshold_spreads, 0.0, 1e3));
    status.Update(CheckRange("threshold_incoherent_spreads", evidence.threshold_incoherent_spreads,
                             0.0, 1e3));
    status.Update(CheckRange("faint_spreads", evidence.faint_spreads, 0.0, 1e3));
    status.Update(
        CheckRange("faint_incoherent_spreads", evidence.faint_incoherent_spreads, 0.0, 1e3));
    status.Update(CheckRange("max_peaks", evidence.max_peaks, 0, 100));
    status.Update(CheckRange("peak_radius_rad", evidence.peak_radius_rad, 0.0, kPi));
    status.Update(CheckRange("undecided_radius_rad", evidence.undecided_radius_rad,
                             evidence.peak_radius_rad, kPi));
    status.Update(CheckProbability("p_peak", evidence.p_peak));
    status.Update(CheckProbability("p_undecided", evidence.p_undecided));
    status.Update(CheckProbability("p_rest", evidence.p_rest));
    return status;
  }
};

}  // namespace

AcousticsConfig AcousticsConfig::Paper() {
  AcousticsConfig config;
  config.window_samples = 400;
  config.f_max_hz = 3000.0;
  config.grid = SectorGrid{};
  config.evidence = DoubleThreshold{};
  return config;
}

absl::Status AcousticsConfig::Validate() const {
  absl::Status status;
  if (window_samples) {
    status.Update(CheckRange("window_samples", *window_samples, 4, kMaxWindowSamples));
    if (*window_samples % 2 != 0) {
      status.Update(absl::InvalidArgumentError(absl::StrCat(
          "acoustics.window_samples is ", *window_samples, "; the hop W/2 needs an even one")));
    }
  } else {
    status.Update(CheckRange("window_s", window_s, 1e-4, 1.0));
  }
  status.Update(CheckRange("frames_per_scan", frames_per_scan, 1, 10000));
  status.Update(CheckRange("f_min_hz", f_min_hz, 0.0, 96000.0));
  status.Update(CheckRange("f_max_hz", f_max_hz, f_min_hz, 96000.0));
  status.Update(CheckRange("speed_of_sound_mps", speed_of_sound_mps, 100.0, 10000.0));
  status.Update(std::visit(GridCheck{}, grid));
  status.Update(std::visit(EvidenceCheck{}, evidence));
  return status;
}

geometry::DirectionGrid AcousticsConfig::MakeGrid() const {
  if (const auto* sector = std::get_if<SectorGrid>(&grid)) {
    return geometry::DirectionGrid::Sector(sector->azimuth_min_rad, sector->azimuth_max_rad,
                                           sector->elevation_min_rad, sector->elevation_max_rad,
                                           sector->step_rad);
  }
  return geometry::DirectionGrid::EqualArea(std::get<EqualAreaGrid>(grid).spacing_rad);
}

absl::StatusOr<FrameLayout> FrameLayout::Create(const AcousticsConfig& config, int sample_rate_hz) {
  absl::Status status = config.Validate();
  if (!status.ok()) return status;
  if (sample_rate_hz < 8000 || sample_rate_hz > 192000) {
    return absl::InvalidArgumentError(absl::StrCat("the audio's sample rate is ", sample_rate_hz,
                                                   " Hz; it must be from 8000 to 192000 Hz"));
  }
  FrameLayout layout;
  layout.sample_rate_hz = sample_rate_hz;
  layout.window_samples = config.window_samples.value_or(
      2 * static_cast<int>(std::lround(config.window_s * sample_rate_hz / 2.0)));
  layout.frames_per_scan = config.frames_per_scan;
  if (layout.window_samples < 4 || layout.window_samples > kMaxWindowSamples) {
    return absl::InvalidArgumentError(absl::StrCat("acoustics.window_s gives ",
                                                   layout.window_samples, " samples at ",
                                                   sample_rate_hz, " Hz; W must be 4 to 65536"));
  }
  // W is at most 2^16 and K at most 10^4, so the product fits in an int.
  if (layout.scan_samples() > kMaxScanDuration_s * sample_rate_hz) {
    return absl::InvalidArgumentError(absl::StrCat("an audio scan of ", config.frames_per_scan,
                                                   " frames lasts longer than ", kMaxScanDuration_s,
                                                   " s"));
  }
  const double f_max_hz = std::min(config.f_max_hz, sample_rate_hz / 2.0);
  const double bins_per_hz = static_cast<double>(layout.window_samples) / sample_rate_hz;
  constexpr double kRounding = 1e-9;  // keeps a bin that lies on a limit
  layout.first_bin = static_cast<int>(std::ceil(config.f_min_hz * bins_per_hz - kRounding));
  layout.bins =
      static_cast<int>(std::floor(f_max_hz * bins_per_hz + kRounding)) - layout.first_bin + 1;
  if (layout.bins < 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("no frequency bin lies in the band from acoustics.f_min_hz, ", config.f_min_hz,
                     " Hz, to ", f_max_hz, " Hz: the bins of audio sampled at ", sample_rate_hz,
                     " Hz are ", 1.0 / bins_per_hz, " Hz apart"));
  }
  return layout;
}

}  // namespace soundmap::acoustics
