#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/stft.h"

namespace soundmap::acoustics {

// Which microphones have inverted polarity, as wrong wiring makes it. Where two microphones are at
// most a quarter of a wave apart, k d <= pi/2, the real part of their cross-spectrum is positive in
// any sound field: cos(k d cos(angle)) of each wave, sinc(k d) of a diffuse field. One that is
// negative with its neighbours has the opposite sign.
//
// It says nothing, and keeps what it said, where the sound cannot tell: noise of the microphones
// alone; a lone hum, of which the array may stand in a node; two groups of one size. Of two
// microphones, or where neighbours are more than some 0.25 m apart, it never says anything.
class Polarity {
 public:
  // From 100 Hz on; fewer where neighbours are far apart.
  static constexpr int kMaxBins = 16;

  // What the past leaves behind, all of it.
  struct State {
    std::vector<float> agreement;              // of each pair: sum of the cosines of its phases
    std::array<float, kMaxBins> bin_weight{};  // how many of them are of each bin
    std::vector<int> inverted;

    bool operator==(const State&) const = default;
  };

  // 64 microphones at most.
  Polarity(const FrameLayout& layout, double speed_of_sound_mps,
           const std::vector<Eigen::Vector3d>& mic_in_array_m);

  // One frame a scan. `frame` has the microphones but those of `without` (ascending), those of
  // inverted() with their sign turned.
  void Add(const FrameSpectra& frame, std::span<const int> without);

  // In channel order; less than half of them.
  const std::vector<int>& inverted() const { return state_.inverted; }

  const State& state() const { return state_; }
  // False, and no change: no such array can have had this state.
  bool Restore(State state);

 private:
  struct Pair {
    int a = 0;
    int b = 0;
  };

  // Which bins have sound of their own, 1 or 0. False: none.
  bool Audible(const FrameSpectra& frame, int rows, std::array<float, kMaxBins>& audible) const;
  void Decide(std::span<const int> without);

  int microphones_;
  int window_samples_;
  int first_bin_;
  int bins_ = 0;
  float keep_;
  std::vector<Pair> pairs_;  // neighbours, which connect all; empty: never says anything
  State state_;
};

}  // namespace soundmap::acoustics
