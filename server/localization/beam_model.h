#pragma once

#include <span>
#include <vector>

#include "localization/beam_caster.h"
#include "localization/config.h"

namespace soundmap::localization {

// The four-part beam model of Probabilistic Robotics, section 6.3, as a table of logarithms: the
// probability that a beam which by the map ends at r reads z. Readings fall into bins of
// resolution_m, the last one holds max_range_m and all beyond.
//  hit:    normal around r, cut to the range of the sensor        short: exponential, up to r
//  max:    the last bin                                            random: uniform
// Where the map does not know what the beam meets after r, the hit part is uniform from r to the
// last bin. Each distribution adds up to 1 over the bins.
class BeamModel {
 public:
  explicit BeamModel(const BeamModelConfig& config);

  // The logarithms for one reading, to be indexed by Column() of what the map expects.
  std::span<const float> Row(double measured_m) const {
    return {log_probability_.data() + static_cast<std::size_t>(Bin(measured_m)) * 2 * bins_,
            static_cast<std::size_t>(2 * bins_)};
  }
  int Column(const Return& expected) const {
    return Bin(expected.range_m) + (expected.ending == Ending::kWall ? 0 : bins_);
  }

  int bins() const { return bins_; }

 private:
  // Rounded: bin b stands for ranges around b * resolution.
  int Bin(double range_m) const {
    const double bin = range_m * bins_per_m_ + 0.5;
    return bin < bins_ ? static_cast<int>(bin) : bins_ - 1;
  }

  int bins_;
  double bins_per_m_;
  std::vector<float> log_probability_;  // [measured][wall, unknown][expected]
};

}  // namespace soundmap::localization
