#include "sources/simulation/wav_file.h"

#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "absl/strings/str_cat.h"

namespace soundmap::simulation {
namespace {

constexpr std::uintmax_t kLargestFileBytes = 512u << 20;

template <typename T>
T At(const std::string& bytes, std::size_t position) {
  T value;
  std::memcpy(&value, bytes.data() + position, sizeof(T));
  return value;
}

}  // namespace

absl::StatusOr<WavFile> ReadWav(const std::string& path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  std::ifstream file(path, std::ios::binary);
  if (error || !file) return absl::NotFoundError(absl::StrCat(path, ": cannot be read"));
  if (size > kLargestFileBytes)
    return absl::InvalidArgumentError(absl::StrCat(path, ": is too large"));
  const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  const auto invalid = [&](const char* what) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", what));
  };
  if (bytes.size() < 12 || bytes.compare(0, 4, "RIFF") != 0 || bytes.compare(8, 4, "WAVE") != 0) {
    return invalid("is not a WAV file");
  }
  int format = 0, channels = 0, bits = 0;
  WavFile wav;
  for (std::size_t position = 12; position + 8 <= bytes.size();) {
    const std::uint64_t length = At<std::uint32_t>(bytes, position + 4);
    const std::size_t body = position + 8;
    const std::size_t available = std::min<std::uint64_t>(length, bytes.size() - body);
    if (bytes.compare(position, 4, "fmt ") == 0 && available >= 16) {
      format = At<std::uint16_t>(bytes, body);
      channels = At<std::uint16_t>(bytes, body + 2);
      const auto rate_hz = At<std::uint32_t>(bytes, body + 4);
      bits = At<std::uint16_t>(bytes, body + 14);
      constexpr int kExtensible = 0xFFFE;
      if (format == kExtensible && available >= 26) format = At<std::uint16_t>(bytes, body + 24);
      if (rate_hz < 1000 || rate_hz > 768000)
        return invalid("has a sample rate that is not supported");
      wav.sample_rate_hz = static_cast<int>(rate_hz);
    } else if (bytes.compare(position, 4, "data") == 0) {
      const bool pcm16 = format == 1 && bits == 16, float32 = format == 3 && bits == 32;
      if ((!pcm16 && !float32) || channels < 1) return invalid("is not 16 bit PCM or 32 bit float");
      const std::size_t stride = static_cast<std::size_t>(channels) * bits / 8;
      wav.samples.reserve(available / stride);
      for (std::size_t i = body; i + stride <= body + available; i += stride) {
        const float value = pcm16 ? At<std::int16_t>(bytes, i) / 32768.0f : At<float>(bytes, i);
        if (!std::isfinite(value)) return invalid("has samples that are not finite");
        wav.samples.push_back(value);
      }
      break;
    }
    position = body + length + (length & 1);
  }
  if (wav.samples.empty()) return invalid("has no samples");
  return wav;
}

}  // namespace soundmap::simulation
