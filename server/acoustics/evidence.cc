#include "acoustics/evidence.h"

#include <algorithm>

namespace soundmap::acoustics {

std::vector<float> DoubleThresholdLikelihood(std::span<const float> power,
                                             const DoubleThreshold& evidence) {
  std::vector<float> likelihood(power.size());
  for (std::size_t i = 0; i < power.size(); ++i) {
    likelihood[i] = static_cast<float>(power[i] < evidence.t1   ? evidence.p_min
                                       : power[i] > evidence.t2 ? evidence.p_max
                                                                : evidence.p_med);
  }
  return likelihood;
}

std::vector<float> ScaledPowerLikelihood(std::span<const float> power,
                                         const ScaledPower& evidence) {
  std::vector<float> likelihood(power.size(), static_cast<float>(evidence.p_min));
  const auto [least, most] = std::minmax_element(power.begin(), power.end());
  if (power.empty() || !(*most > *least)) return likelihood;
  const double slope = (evidence.p_max - evidence.p_min) / (*most - *least);
  for (std::size_t i = 0; i < power.size(); ++i) {
    likelihood[i] = static_cast<float>(evidence.p_min + slope * (power[i] - *least));
  }
  return likelihood;
}

}  // namespace soundmap::acoustics
