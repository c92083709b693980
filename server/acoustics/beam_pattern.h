#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "acoustics/config.h"
#include "geometry/directions.h"

namespace soundmap::acoustics {

// How the array answers to a plane wave and to noise: eqs. (2)-(5) applied to what is known of
// them. Directions are unit vectors in mic_array. Immutable; any number of threads.
class BeamPattern {
 public:
  // Of an array and a band that SrpPhat::Create() accepts.
  BeamPattern(const FrameLayout& layout, double speed_of_sound_mps,
              const std::vector<Eigen::Vector3d>& mic_in_array_m,
              const geometry::DirectionGrid& grid);

  // The power in `direction` of a unit plane wave from `source`: B where they are equal.
  double ResponseAt(const Eigen::Vector3d& source, const Eigen::Vector3d& direction) const;

  // power[i] += gain * (ResponseAt(source, grid[i]) - offset), each response within 1e-2 B
  // (typically 1e-3 B); for all i, or for those of the sample.
  void AddResponse(const Eigen::Vector3d& source, float gain, float offset,
                   std::span<float> power) const {
    AddResponse(source, gain, offset, /*stride=*/1, power);
  }
  void AddResponseToSample(const Eigen::Vector3d& source, float gain, float offset,
                           std::span<float> power) const {
    AddResponse(source, gain, offset, sample_stride_, power);
  }
  // About 2000 directions or more, spread over the grid: enough for its statistics.
  bool InSample(int i) const { return i / 4 % sample_stride_ == 0; }

  // Standard deviation of S, in one direction, in noise that is independent at each microphone.
  double IncoherentSpread() const;

  // The directions that the array cannot tell from `direction` have the same image under this map:
  // itself in space, its mirror image for microphones in a plane, a cone for microphones in a line.
  // Image points of distinguishable directions are as far apart as they are.
  Eigen::Vector3d Distinguishable(const Eigen::Vector3d& direction) const;

  // 1: the microphones lie in a line, 2: in a plane, 3: in space.
  int array_rank() const { return array_rank_; }

 private:
  // Microphone pairs with one difference vector.
  struct PairGroup {
    Eigen::Vector3d delay_s;  // of the vector
    int count = 0;
  };

  void BuildGroups(double speed_of_sound_mps, const std::vector<Eigen::Vector3d>& mic_in_array_m);
  void BuildAxes();
  void BuildResponse();
  void BuildPositions(const geometry::DirectionGrid& grid);
  std::int32_t FinePosition(const PairGroup& group, const Eigen::Vector3d& direction) const;
  void AddResponse(const Eigen::Vector3d& source, float gain, float offset, int stride,
                   std::span<float> power) const;

  FrameLayout layout_;
  int microphones_;
  std::vector<PairGroup> groups_;
  int array_rank_ = 3;
  Eigen::Vector3d array_axis_ = Eigen::Vector3d::UnitZ();  // of a line; normal of a plane
  std::vector<float> response_;  // sum over the band of cos(2 pi f tau), by delay
  int response_centre_ = 0;
  double response_step_s_ = 0.0;
  int tiles_ = 0;
  int sample_stride_ = 1;                // in fours of directions
  std::vector<std::int32_t> positions_;  // of the directions' delays, tile by tile, group by group
};

}  // namespace soundmap::acoustics
