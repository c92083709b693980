#include "acoustics/evidence.h"

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

}  // namespace soundmap::acoustics
