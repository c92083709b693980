#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/spline_table.h"

namespace soundmap::acoustics {

// How the array answers to a plane wave and to noise: eqs. (2)-(5) applied to what is known of
// them. Directions are unit vectors in mic_array. Immutable; any number of threads.
class BeamPattern {
 public:
  // No response is off by more than this share of B, and typically by a third of it.
  static constexpr double kMaxError = 2e-4;

  // Of an array and a band that SrpPhat::Create() accepts.
  BeamPattern(const FrameLayout& layout, double speed_of_sound_mps,
              const std::vector<Eigen::Vector3d>& mic_in_array_m);

  // The power in `direction` of a unit plane wave from `source`: B where they are equal.
  double ResponseAt(const Eigen::Vector3d& source, const Eigen::Vector3d& direction) const;

  // Directions prepared for AddResponse().
  class Places {
   public:
    int size() const { return size_; }

   private:
    friend class BeamPattern;
    int size_ = 0;
    std::vector<float> at_[3];  // padded
  };
  Places Prepare(std::span<const Eigen::Vector3d> directions) const;

  // power[i] += gain * (the response in direction first + i - offset), for as many as `power` has.
  // `plain`: as on a processor without AVX2, with the same bits.
  void AddResponse(const Eigen::Vector3d& source, float gain, float offset,
                   const Places& directions, int first, std::span<float> power,
                   bool plain = false) const;

  // Standard deviation of S, in one direction, in noise that is independent at each microphone.
  double IncoherentSpread() const;
  // S of such noise, on average.
  double Incoherent() const { return static_cast<double>(layout_.bins) / microphones_; }

  // Half the period with which S changes along the array's longest side, at the band's root mean
  // square frequency: as fine as a beam is on average over the band.
  double resolution_rad() const { return resolution_rad_; }

  // The directions that the array cannot tell from `direction` have the same image under this map:
  // itself in space, its mirror image for microphones in a plane, a cone for microphones in a line.
  // Image points of distinguishable directions are as far apart as they are.
  Eigen::Vector3d Distinguishable(const Eigen::Vector3d& direction) const;

  // The part of a vector along the plane of microphones that lie in one.
  Eigen::Vector3d AlongPlane(const Eigen::Vector3d& v) const {
    return v - array_axis_.dot(v) * array_axis_;
  }

  // The other direction with the same response, for microphones in a plane.
  Eigen::Vector3d MirrorImage(const Eigen::Vector3d& direction) const {
    return direction - 2.0 * array_axis_.dot(direction) * array_axis_;
  }

  // 1: the microphones lie in a line, 2: in a plane, 3: in space.
  int array_rank() const { return array_rank_; }
  // Of a line; normal of a plane.
  const Eigen::Vector3d& array_axis() const { return array_axis_; }

 private:
  // Microphone pairs with one difference vector.
  struct PairGroup {
    Eigen::Vector3d delay_s;  // of the vector
    int count = 0;
    Eigen::Vector3d delay_steps = Eigen::Vector3d::Zero();  // the same, in steps of band_
  };

  void BuildGroups(double speed_of_sound_mps, const std::vector<Eigen::Vector3d>& mic_in_array_m);
  void BuildAxes();
  void BuildBand();
  void BuildTable();
  double StepAlong(const Eigen::Vector3d& axis) const;
  double BandSum(double delay_s) const;     // sum over the band of cos(2 pi f tau)
  double BandAt(double delay_steps) const;  // the same, between the values of band_
  double PairByPair(const Eigen::Vector3d& difference) const;
  SplineTable table() const {
    return {table_.data(),
            array_rank_,
            {begin_[0], begin_[1], begin_[2]},
            {length_[0], length_[1], length_[2]}};
  }

  FrameLayout layout_;
  int microphones_;
  std::vector<PairGroup> groups_;
  int array_rank_ = 3;
  Eigen::Vector3d array_axis_ = Eigen::Vector3d::UnitZ();
  double resolution_rad_ = 0.0;

  std::vector<float> band_;  // BandSum(), by delay
  double band_step_s_ = 0.0;

  // The response depends on the difference d of direction and source alone, and is the same for -d;
  // for a plane only the part of d in the plane counts. The table has the coefficients of cubic
  // B-splines over d on the array's principal axes, the widest last, in steps along each; the first
  // coordinate that counts is never negative. Empty where it would be too large: then all goes pair
  // by pair.
  std::vector<float> table_;
  Eigen::Matrix3d steps_from_direction_ = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d direction_from_steps_ = Eigen::Matrix3d::Zero();
  int begin_[3] = {0, 0, 0};  // of the table, in steps
  int length_[3] = {1, 1, 1};
};

}  // namespace soundmap::acoustics
