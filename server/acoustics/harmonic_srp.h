#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/kernels.h"
#include "acoustics/ring_grid.h"
#include "geometry/directions.h"

namespace soundmap::acoustics {

// The power of all directions from the cross-spectra of the microphone pairs, by way of its
// spherical harmonics. In a pair with the delay vector d = (p_a - p_b) / c, a plane wave is
//   e^{-j w d.u} = sum over l of (2 l + 1) (-j)^l j_l(w |d|) P_l(d.u / |d|)
// (Rayleigh), and the addition theorem splits P_l into harmonics of d and of u. So the linear map
// from the cross-spectra to the directions passes through (L + 1)^2 harmonics, L a little above the
// phase across the array in radians. Each step is cheap for a reason of its own: the first works on
// each pair alone, the last two on the rings and the azimuths of the grid.
//
// Each pair's series is cut where what is left is below kTruncation for any spectrum of magnitude
// 1, which bounds the error of S / B by kTruncation. Immutable; thread safe.
class HarmonicSrp {
 public:
  static constexpr double kTruncation = 3e-6;

  // `delay_s`: the pairs' delay vectors, longest first. Null: the directions are not in rings, or
  // the array is so large for its grid that look-ups would be faster.
  static std::unique_ptr<const HarmonicSrp> Create(const FrameLayout& layout,
                                                   const std::vector<Eigen::Vector3d>& delay_s,
                                                   const geometry::DirectionGrid& grid,
                                                   const Kernels& kernels = BestKernels());

  int degree() const { return degree_; }

  // Floats that the two functions below may overwrite.
  std::size_t workspace_floats() const;
  // The harmonics of `constant` plus `scale` times the sum over all pairs and bins of
  // Re(C e^{-j w d.u}). The cross-spectra C are pair by pair, in rows of `width` bins.
  void Expand(const float* real, const float* imaginary, int width, float scale, float constant,
              float* workspace, std::vector<float>& harmonics) const;
  // What they add up to in every direction of the grid, and in any one.
  void Synthesize(std::span<const float> harmonics, float* workspace, std::span<float> value) const;
  double ValueAt(std::span<const float> harmonics, const Eigen::Vector3d& direction) const;

 private:
  // Consecutive pairs of one length.
  struct Length {
    int first = 0;
    int count = 0;
    int degree = 0;
    std::size_t table = 0;  // in bessel_: bins by even l, then bins by odd l
  };
  // Consecutive rings with one table of azimuths.
  struct Azimuths {
    int first = 0;  // in rings_
    int count = 0;
    int max_order = 0;
    int width = 0;
    std::size_t table = 0;  // in azimuths_: orders of the four kinds by azimuths
  };
  struct RingPlace {
    int height = 0;  // lane of the tables by height
    bool south = false;
    Ring ring;
  };

  explicit HarmonicSrp(const Kernels& kernels) : kernels_(kernels) {}
  bool Build(const std::vector<Eigen::Vector3d>& delay_s, const FrameLayout& layout,
             const RingGrid& grid, int directions);
  void BuildPairs(const std::vector<Eigen::Vector3d>& delay_s, const FrameLayout& layout);
  void BuildRings(const RingGrid& grid);
  void BuildRecurrence();
  // harmonics[HarmonicIndex(l, m, sine)]: rows of equal l - m.
  std::size_t HarmonicIndex(int l, int m, bool sine) const {
    return static_cast<std::size_t>(2 * (l - m) + (sine ? 1 : 0)) * row_ + m;
  }

  const Kernels& kernels_;
  int degree_ = 0;
  int row_ = 0;  // floats of a row of harmonics
  double centre_azimuth_rad_ = 0.0;

  int bins_ = 0;
  int pairs_ = 0;
  int even_ = 0;  // floats for even l, and for odd l, of one pair
  int odd_ = 0;
  std::vector<Length> lengths_;
  std::vector<float> bessel_;
  std::vector<int> pairs_of_degree_;            // with that degree or a higher one
  std::vector<std::size_t> pair_harmonics_at_;  // by l: pairs by 2 l + 1 harmonics
  std::vector<float> pair_harmonics_;

  int heights_ = 0;                       // padded; nearest to the equator first
  std::vector<int> heights_of_order_;     // padded, where the order is not negligible
  std::vector<int> rings_of_order_;       // at those heights
  std::vector<std::size_t> legendre_at_;  // by 2 m + (l - m) % 2: degrees by heights
  std::vector<float> legendre_;
  std::vector<RingPlace> rings_;
  std::vector<Azimuths> arcs_;
  std::vector<float> azimuths_;
  int widest_ = 0;

  std::vector<double>
      factor_;  // of the recurrence of NormalizedLegendre, in the order of harmonics
  std::vector<double> before_factor_;
  std::vector<double> sectoral_factor_;
};

}  // namespace soundmap::acoustics
