#pragma once

#include <cstdint>
#include <memory>
#include <random>
#include <span>

#include "absl/status/statusor.h"
#include "sources/simulation/scene.h"

namespace soundmap::simulation {

// An endless signal. All but kClick have an rms amplitude of 1 over a long time; kClick is an
// impulse of 1 each second.
class Sound {
 public:
  virtual ~Sound() = default;
  virtual void Next(std::span<float> samples) = 0;
};

// `first_sample` is the index of the first sample to come; clicks fall on samples (k + 1/2) *
// sample_rate_hz. Errors come from a .wav file.
absl::StatusOr<std::unique_ptr<Sound>> MakeSound(const SourceConfig& source, int sample_rate_hz,
                                                 std::int64_t first_sample,
                                                 const std::mt19937_64& engine);

// Peak over rms that is rarely passed.
double CrestFactor(SoundKind kind);

}  // namespace soundmap::simulation
