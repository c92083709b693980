#pragma once

#include <span>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/likelihood_scan.h"
#include "acoustics/srp_phat.h"

namespace soundmap::acoustics {

// Eq. (6): F(S) for every direction; F(T1) = F(T2) = p_med.
std::vector<float> DoubleThresholdLikelihood(std::span<const float> power,
                                             const DoubleThreshold& evidence);

struct Peaks {
  double noise_floor = 0.0;
  double spread = 0.0;
  // Strongest first. `power` is S at the peak less the responses of the peaks found before it.
  std::vector<Peak> peaks;
};

// Peak removal with the known beam: the largest power above the threshold is a source; a plane
// wave's response from there, scaled to bring it down to the noise floor, is taken off; and so on.
// Directions are refined between those of the grid. A source outside the grid is taken off, but not
// reported.
Peaks FindPeaks(const SrpPhat& srp, const AudioScan& scan, const PeakEvidence& evidence);

// Directions that the array cannot tell from a peak count as that peak.
std::vector<float> PeakLikelihood(const SrpPhat& srp, std::span<const Peak> peaks,
                                  const PeakEvidence& evidence);

}  // namespace soundmap::acoustics
