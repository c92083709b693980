#pragma once

#include <span>
#include <vector>

#include "acoustics/config.h"

namespace soundmap::acoustics {

// Eq. (6): F(S) for every direction; F(T1) = F(T2) = p_med.
std::vector<float> DoubleThresholdLikelihood(std::span<const float> power,
                                             const DoubleThreshold& evidence);

}  // namespace soundmap::acoustics
