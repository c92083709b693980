#include "localization/beam_model.h"

#include <cmath>

namespace soundmap::localization {

BeamModel::BeamModel(const BeamModelConfig& config)
    : bins_(static_cast<int>(std::lround(config.max_range_m / config.resolution_m)) + 1),
      bins_per_m_(1.0 / config.resolution_m),
      log_probability_(static_cast<std::size_t>(2) * bins_ * bins_) {
  std::vector<double> hit(bins_);
  std::vector<double> shorter(bins_);
  for (const bool wall : {true, false}) {
    for (int expected = 0; expected < bins_; ++expected) {
      double hit_sum = 0.0;
      double shorter_sum = 0.0;
      for (int measured = 0; measured < bins_; ++measured) {
        const double deviation = (measured - expected) * config.resolution_m / config.hit_std_m;
        hit[measured] =
            wall ? std::exp(-0.5 * deviation * deviation) : (measured >= expected ? 1.0 : 0.0);
        shorter[measured] =
            measured <= expected
                ? std::exp(-config.short_rate_per_m * measured * config.resolution_m)
                : 0.0;
        hit_sum += hit[measured];
        shorter_sum += shorter[measured];
      }
      for (int measured = 0; measured < bins_; ++measured) {
        const double probability = config.hit_weight * hit[measured] / hit_sum +
                                   config.short_weight * shorter[measured] / shorter_sum +
                                   config.max_weight * (measured == bins_ - 1 ? 1.0 : 0.0) +
                                   config.random_weight / bins_;
        log_probability_[(static_cast<std::size_t>(measured) * 2 + (wall ? 0 : 1)) * bins_ +
                         expected] = static_cast<float>(std::log(probability));
      }
    }
  }
}

}  // namespace soundmap::localization
