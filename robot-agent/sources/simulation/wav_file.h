#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace soundmap::simulation {

struct WavFile {
  int sample_rate_hz = 0;
  std::vector<float> samples;  // first channel, full scale 1
};

// RIFF WAVE with 16 bit PCM or 32 bit float samples, at most 512 MiB. Errors are one sentence that
// names the file.
absl::StatusOr<WavFile> ReadWav(const std::string& path);

}  // namespace soundmap::simulation
