#pragma once

#include <fftw3.h>

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <type_traits>
#include <vector>

#include "acoustics/config.h"
#include "acoustics/srp_phat.h"
#include "acoustics/stft.h"
#include "geometry/directions.h"

// Other ways from the spectra of eq. (1) to the power of eq. (5).
namespace soundmap::benchmarks {

// Eqs. (2)-(5) as matrix products: in each bin, the steering vectors of all directions times the
// spectra of all frames. Complex numbers are spelled out as pairs of real rows, which Eigen
// multiplies twice as fast as its complex type.
class BinGemm {
 public:
  BinGemm(const acoustics::FrameLayout& layout, double speed_of_sound_mps,
          const std::vector<Eigen::Vector3d>& mic_in_array_m, const geometry::DirectionGrid& grid);
  std::vector<float> Power(const acoustics::PhatSpectra& spectra);

 private:
  std::vector<Eigen::MatrixXf> steering_;  // a bin: real parts over imaginary parts, by directions
  Eigen::MatrixXf response_;
};

// Generalized cross-correlation with a table of delays: the averaged cross-spectrum of each pair,
// zero-padded to kInterpolation times the sample rate, is transformed back to the time domain, and
// each direction reads the nearest sample of each pair.
class GccLookup {
 public:
  static constexpr int kInterpolation = 4;

  GccLookup(const acoustics::FrameLayout& layout, double speed_of_sound_mps,
            const std::vector<Eigen::Vector3d>& mic_in_array_m,
            const geometry::DirectionGrid& grid);
  std::vector<float> Power(const acoustics::PhatSpectra& spectra);

 private:
  template <auto Free>
  struct Deleter {
    template <typename T>
    void operator()(T* object) const {
      Free(object);
    }
  };

  acoustics::FrameLayout layout_;
  int microphones_;
  int directions_;
  std::unique_ptr<fftwf_complex, Deleter<&fftwf_free>> spectrum_;
  std::unique_ptr<float, Deleter<&fftwf_free>> correlation_;
  std::unique_ptr<std::remove_pointer_t<fftwf_plan>, Deleter<&fftwf_destroy_plan>> plan_;
  std::vector<std::uint16_t> delay_;  // pair by pair, a sample of the correlation each direction
};

// Our own way for grids that are not rings: correlations of the pairs as cubics of the delay.
class CubicLookUp {
 public:
  CubicLookUp(const acoustics::FrameLayout& layout, double speed_of_sound_mps,
              const std::vector<Eigen::Vector3d>& mic_in_array_m,
              const geometry::DirectionGrid& grid);
  std::vector<float> Power(const acoustics::PhatSpectra& spectra);

 private:
  std::shared_ptr<const acoustics::SrpPhat> srp_;
  std::vector<int> place_;  // of the directions in a grid without rings
};

}  // namespace soundmap::benchmarks
