#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "acoustics/beam_pattern.h"
#include "acoustics/config.h"
#include "acoustics/direction_cells.h"
#include "acoustics/likelihood_scan.h"
#include "acoustics/srp_phat.h"

namespace soundmap::acoustics {

struct Peaks {
  double noise_floor = 0.0;
  double spread = 0.0;
  // Strongest first. `power` is S at the peak less the responses of the peaks found before it.
  std::vector<Peak> peaks;
  // Indices in the grid: local maxima of S as it is and of what is left of it without the strong
  // peaks, 2.5 spreads or more above the noise floor. Single ones say nothing; which places they
  // come again from does.
  std::vector<int> maxima;
};

// Peak removal with the known beam: the largest power above the threshold is a source; a plane
// wave's response from there, scaled to bring it down to the noise floor, is taken off; and so on.
// Directions are refined between those of the grid. A source outside the grid is taken off, but not
// reported. So far each is taken for as loud in all of the band as it is on average; then the waves
// from there are taken off bin by bin, whatever their spectra, and what is left shows the local
// maxima that stand less high, which need not be taken off.
//
// The power is kept up to date in the centres of cells alone, which are closer than the array
// resolves; the rest of the grid is looked at where a maximum can be. Immutable; any number of
// threads.
class PeakFinder {
 public:
  // `srp` is of that layout and array, and outlives this.
  PeakFinder(const PeakEvidence& evidence, const FrameLayout& layout, double speed_of_sound_mps,
             const std::vector<Eigen::Vector3d>& mic_in_array_m,
             std::shared_ptr<const SrpPhat> srp);

  // `memory` is to work in, and kept for the next scan.
  Peaks Find(const AudioScan& scan, AudioScan& memory) const;
  Peaks Find(const AudioScan& scan) const {
    AudioScan memory;
    return Find(scan, memory);
  }

  // The likelihood of every direction of the grid. Directions that the array cannot tell from a
  // peak count as that peak; those of a reflection are undecided. What an array in a plane hears
  // depends on the directions' parts along it, which hardly change with the height near the plane:
  // there, all heights count that it tells no better apart than two that lie peak_radius_rad apart
  // at 45 degrees.
  std::vector<float> Likelihood(std::span<const Peak> peaks) const;

  const BeamPattern& beam() const { return beam_; }
  // The directions of the grid that noise floor and spread are taken from.
  std::vector<int> sample() const { return {cells_.centres().begin(), cells_.centres().end()}; }

 private:
  // A plane wave that has been taken off: gain 1 is a source without any noise.
  struct Removed {
    Eigen::Vector3d source;
    double gain;
  };
  struct Background {
    double floor;
    double spread;
  };
  struct Maximum {
    float power;
    int direction;  // in the grid
  };

  double ResidualAt(const AudioScan& scan, std::span<const Removed> removed,
                    const Eigen::Vector3d& direction) const;
  Eigen::Vector3d Climb(const AudioScan& scan, std::span<const Removed> removed,
                        const Eigen::Vector3d& start) const;
  // The largest residual of the grid, if it may be more than `least_height` above `floor`.
  Maximum Largest(const AudioScan& scan, std::span<const Removed> removed,
                  std::span<const float> residual, double floor, double least_height) const;
  // The largest residual of the grid in one cell.
  Maximum LargestOf(const AudioScan& scan, std::span<const Removed> removed, int cell) const;
  // The power in the centres of the cells.
  void ReadCentres(const AudioScan& scan, std::vector<float>& residual) const;
  void AddFaint(const AudioScan& scan, std::span<const Eigen::Vector3d> strong,
                std::span<const float> residual, const Background& background, Peaks& found) const;
  std::vector<int> MaximaOf(const AudioScan& scan, const Background& background) const;
  // Of several directions that the array cannot tell apart always the same one.
  Eigen::Vector3d Reported(const Eigen::Vector3d& direction) const;
  Background BackgroundOf(std::span<const float> residual) const;
  bool Covers(const Eigen::Vector3d& direction) const;
  double Reach_rad(const Eigen::Vector3d& direction, double along_plane) const;

  PeakEvidence evidence_;
  std::shared_ptr<const SrpPhat> srp_;
  BeamPattern beam_;
  DirectionCells cells_;
  BeamPattern::Places centres_;
  BeamPattern::Places members_;
  // Directions of the grid near direction i: [first_neighbour_[i], first_neighbour_[i + 1]).
  std::vector<int> neighbours_;
  std::vector<int> first_neighbour_;
};

}  // namespace soundmap::acoustics
