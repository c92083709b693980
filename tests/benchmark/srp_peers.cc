#include "tests/benchmark/srp_peers.h"

#include <algorithm>
#include <cmath>

#include "geometry/angles.h"
#include "tests/benchmark/require.h"

namespace soundmap::benchmarks {

using acoustics::PhatSpectra;
using geometry::kPi;

BinGemm::BinGemm(const acoustics::FrameLayout& layout, double speed_of_sound_mps,
                 const std::vector<Eigen::Vector3d>& mic_in_array_m,
                 const geometry::DirectionGrid& grid) {
  const int microphones = static_cast<int>(mic_in_array_m.size());
  for (int b = 0; b < layout.bins; ++b) {
    Eigen::MatrixXf& steering = steering_.emplace_back(2 * microphones, grid.size());
    for (int i = 0; i < grid.size(); ++i) {
      for (int n = 0; n < microphones; ++n) {
        const double tau =
            2.0 * kPi * layout.bin_hz(b) * mic_in_array_m[n].dot(grid[i]) / speed_of_sound_mps;
        steering(n, i) = static_cast<float>(std::cos(tau) / microphones);
        steering(microphones + n, i) = static_cast<float>(-std::sin(tau) / microphones);
      }
    }
  }
}

std::vector<float> BinGemm::Power(const PhatSpectra& spectra) {
  constexpr int kBlock = 512;  // the response of this many directions stays in the cache
  const int microphones = spectra.microphones;
  const int directions = static_cast<int>(steering_[0].cols());
  std::vector<float> power(directions, 0.0f);
  Eigen::MatrixXf frames(2 * spectra.frames, 2 * microphones);
  for (int b = 0; b < spectra.bins; ++b) {
    for (int t = 0; t < spectra.frames; ++t) {
      for (int n = 0; n < microphones; ++n) {
        const float real = spectra.real[spectra.index(t, n, b)];
        const float imaginary = spectra.imaginary[spectra.index(t, n, b)];
        frames(2 * t, n) = real;
        frames(2 * t, microphones + n) = -imaginary;
        frames(2 * t + 1, n) = imaginary;
        frames(2 * t + 1, microphones + n) = real;
      }
    }
    for (int first = 0; first < directions; first += kBlock) {
      const int count = std::min(kBlock, directions - first);
      response_.noalias() = frames * steering_[b].middleCols(first, count);
      Eigen::Map<Eigen::RowVectorXf>(&power[first], count) += response_.colwise().squaredNorm();
    }
  }
  for (float& value : power) value /= static_cast<float>(spectra.frames);
  return power;
}

GccLookup::GccLookup(const acoustics::FrameLayout& layout, double speed_of_sound_mps,
                     const std::vector<Eigen::Vector3d>& mic_in_array_m,
                     const geometry::DirectionGrid& grid)
    : layout_(layout),
      microphones_(static_cast<int>(mic_in_array_m.size())),
      directions_(grid.size()) {
  const int length = kInterpolation * layout.window_samples;
  spectrum_.reset(fftwf_alloc_complex(length / 2 + 1));
  correlation_.reset(fftwf_alloc_real(length));
  plan_.reset(fftwf_plan_dft_c2r_1d(length, spectrum_.get(), correlation_.get(),
                                    FFTW_MEASURE | FFTW_PRESERVE_INPUT));
  std::fill_n(&spectrum_.get()[0][0], 2 * (length / 2 + 1), 0.0f);
  for (int a = 0; a < microphones_; ++a) {
    for (int b = a + 1; b < microphones_; ++b) {
      for (const Eigen::Vector3d& direction : grid) {
        const double delay_s =
            (mic_in_array_m[a] - mic_in_array_m[b]).dot(direction) / speed_of_sound_mps;
        const auto sample =
            static_cast<int>(std::lround(-delay_s * layout.sample_rate_hz * kInterpolation));
        delay_.push_back(static_cast<std::uint16_t>((sample + length) % length));
      }
    }
  }
}

std::vector<float> GccLookup::Power(const PhatSpectra& spectra) {
  const int bins = spectra.bins;
  double auto_sum = 0.0;
  for (std::size_t i = 0; i < spectra.real.size(); ++i) {
    auto_sum += spectra.real[i] * spectra.real[i] + spectra.imaginary[i] * spectra.imaginary[i];
  }
  const double squared = static_cast<double>(microphones_) * microphones_;
  std::vector<float> sums(directions_, 0.0f);
  std::vector<float> cross_real(bins);
  std::vector<float> cross_imaginary(bins);
  const std::uint16_t* delay = delay_.data();
  for (int a = 0; a < microphones_; ++a) {
    for (int b = a + 1; b < microphones_; ++b, delay += directions_) {
      std::fill(cross_real.begin(), cross_real.end(), 0.0f);
      std::fill(cross_imaginary.begin(), cross_imaginary.end(), 0.0f);
      float* __restrict real = cross_real.data();
      float* __restrict imaginary = cross_imaginary.data();
      for (int t = 0; t < spectra.frames; ++t) {
        const float* __restrict a_real = &spectra.real[spectra.index(t, a)];
        const float* __restrict a_imaginary = &spectra.imaginary[spectra.index(t, a)];
        const float* __restrict b_real = &spectra.real[spectra.index(t, b)];
        const float* __restrict b_imaginary = &spectra.imaginary[spectra.index(t, b)];
        for (int f = 0; f < bins; ++f) {
          real[f] += a_real[f] * b_real[f] + a_imaginary[f] * b_imaginary[f];
          imaginary[f] += a_imaginary[f] * b_real[f] - a_real[f] * b_imaginary[f];
        }
      }
      for (int f = 0; f < bins; ++f) {
        spectrum_.get()[layout_.first_bin + f][0] = real[f];
        spectrum_.get()[layout_.first_bin + f][1] = imaginary[f];
      }
      fftwf_execute(plan_.get());
      const float* correlation = correlation_.get();
      for (int i = 0; i < directions_; ++i) sums[i] += correlation[delay[i]];
    }
  }
  // The transform adds the negative frequencies: its result is twice the correlation of a pair.
  const auto scale = static_cast<float>(1.0 / (squared * spectra.frames));
  const auto auto_power = static_cast<float>(auto_sum / (squared * spectra.frames));
  for (float& sum : sums) sum = auto_power + scale * sum;
  return sums;
}

CubicLookUp::CubicLookUp(const acoustics::FrameLayout& layout, double speed_of_sound_mps,
                         const std::vector<Eigen::Vector3d>& mic_in_array_m,
                         const geometry::DirectionGrid& grid) {
  // The same directions in turn from both ends: neighbours form no rings.
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < grid.size(); ++i) {
    place_.push_back(i % 2 == 0 ? i / 2 : grid.size() - 1 - i / 2);
    directions.push_back(grid[place_.back()]);
  }
  srp_ =
      acoustics::SrpPhat::Create(layout, speed_of_sound_mps, mic_in_array_m,
                                 geometry::DirectionGrid(std::move(directions), grid.spacing_rad()))
          .value();
  Require(!srp_->by_harmonics(), "the look-up is none");
}

std::vector<float> CubicLookUp::Power(const acoustics::PhatSpectra& spectra) {
  const std::vector<float> in_turn = srp_->Scan(spectra).power;
  std::vector<float> power(in_turn.size());
  for (std::size_t i = 0; i < power.size(); ++i) power[place_[i]] = in_turn[i];
  return power;
}

}  // namespace soundmap::benchmarks
