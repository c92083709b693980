#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

// Interleaved 16-bit samples as FLAC: bare frames, without a stream header, of up to 8 channels a
// stream.
namespace soundmap::recording {

inline constexpr int kFlacChannels = 8;  // a stream

// `samples`: whole samples of `channels` (1 or more), one or more. The streams together have the
// channels in order. Internal: the encoder failed.
absl::StatusOr<std::vector<std::string>> EncodeFlac(std::span<const std::int16_t> samples,
                                                    int channels);

// Fills `out`, little-endian interleaved samples of `channels`, which is what the streams must
// hold, exactly. InvalidArgument with half a sentence on what is wrong. Memory: a few MB beyond
// `out`, whatever the streams say.
absl::Status DecodeFlac(std::span<const std::string* const> streams, int channels,
                        std::span<char> out);

}  // namespace soundmap::recording
