#pragma once

#include <span>
#include <vector>

#include "acoustics/config.h"

namespace soundmap::acoustics {

// Eq. (6): F(S) for every direction; F(T1) = F(T2) = p_med.
std::vector<float> DoubleThresholdLikelihood(std::span<const float> power,
                                             const DoubleThreshold& evidence);

// p_min + (p_max - p_min) (S - min S) / (max S - min S) for every direction; p_min where all powers
// are equal.
std::vector<float> ScaledPowerLikelihood(std::span<const float> power, const ScaledPower& evidence);

}  // namespace soundmap::acoustics
