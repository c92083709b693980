#include "recording/flac_audio.h"

#include <FLAC/stream_decoder.h>
#include <FLAC/stream_encoder.h>

#include <algorithm>
#include <cstring>
#include <memory>

#include "absl/strings/str_cat.h"

namespace soundmap::recording {
namespace {

constexpr int kBitsPerSample = 16;
// Every frame names a rate; the true one stands in the message.
constexpr unsigned kNominalRate_hz = 16000;
constexpr int kMinBlock = 16;
constexpr int kMaxBlock = 4096;
// Higher levels gain less than 1 % on microphones and cost twice the time.
constexpr unsigned kCompressionLevel = 3;

FLAC__StreamEncoderWriteStatus KeepFrames(const FLAC__StreamEncoder*, const FLAC__byte buffer[],
                                          std::size_t bytes, unsigned samples, unsigned,
                                          void* client) {
  const bool is_header = samples == 0;
  if (!is_header) {
    static_cast<std::string*>(client)->append(reinterpret_cast<const char*>(buffer), bytes);
  }
  return FLAC__STREAM_ENCODER_WRITE_STATUS_OK;
}

// Channels first .. first + width - 1.
absl::StatusOr<std::string> EncodeStream(std::span<const std::int16_t> samples, int channels,
                                         int first, int width) {
  const std::unique_ptr<FLAC__StreamEncoder, decltype(&FLAC__stream_encoder_delete)> encoder(
      FLAC__stream_encoder_new(), &FLAC__stream_encoder_delete);
  if (encoder == nullptr) return absl::InternalError("no FLAC encoder");
  const std::size_t count = samples.size() / static_cast<std::size_t>(channels);
  FLAC__StreamEncoder* const e = encoder.get();
  FLAC__stream_encoder_set_channels(e, static_cast<unsigned>(width));
  FLAC__stream_encoder_set_bits_per_sample(e, kBitsPerSample);
  FLAC__stream_encoder_set_sample_rate(e, kNominalRate_hz);
  FLAC__stream_encoder_set_compression_level(e, kCompressionLevel);
  FLAC__stream_encoder_set_blocksize(
      e, static_cast<unsigned>(std::clamp<std::size_t>(count, kMinBlock, kMaxBlock)));
  std::string out;
  if (FLAC__stream_encoder_init_stream(e, &KeepFrames, nullptr, nullptr, nullptr, &out) !=
      FLAC__STREAM_ENCODER_INIT_STATUS_OK) {
    return absl::InternalError("the FLAC encoder does not start");
  }
  std::vector<FLAC__int32> block(static_cast<std::size_t>(kMaxBlock * width));
  for (std::size_t begin = 0; begin < count; begin += kMaxBlock) {
    const std::size_t n = std::min<std::size_t>(kMaxBlock, count - begin);
    for (std::size_t s = 0; s < n; ++s) {
      const auto* sample = &samples[(begin + s) * static_cast<std::size_t>(channels) +
                                    static_cast<std::size_t>(first)];
      std::copy(sample, sample + width, &block[s * static_cast<std::size_t>(width)]);
    }
    if (!FLAC__stream_encoder_process_interleaved(e, block.data(), static_cast<unsigned>(n))) {
      return absl::InternalError("the FLAC encoder failed");
    }
  }
  if (!FLAC__stream_encoder_finish(e)) return absl::InternalError("the FLAC encoder failed");
  return out;
}

// One stream on its way into its channels of the interleaved samples.
struct Decoding {
  std::string_view in;
  char* out = nullptr;  // first sample of the stream's first channel
  std::size_t stride_bytes = 0;
  std::size_t missing = 0;  // samples of each channel
  unsigned width = 0;       // channels; 0: not known before the first frame
  unsigned max_width = 0;
  const char* fault = nullptr;
};

FLAC__StreamDecoderReadStatus Read(const FLAC__StreamDecoder*, FLAC__byte buffer[],
                                   std::size_t* bytes, void* client) {
  auto& decoding = *static_cast<Decoding*>(client);
  if (decoding.fault != nullptr) return FLAC__STREAM_DECODER_READ_STATUS_ABORT;
  *bytes = std::min(*bytes, decoding.in.size());
  if (*bytes == 0) return FLAC__STREAM_DECODER_READ_STATUS_END_OF_STREAM;
  std::memcpy(buffer, decoding.in.data(), *bytes);
  decoding.in.remove_prefix(*bytes);
  return FLAC__STREAM_DECODER_READ_STATUS_CONTINUE;
}

FLAC__StreamDecoderWriteStatus Write(const FLAC__StreamDecoder*, const FLAC__Frame* frame,
                                     const FLAC__int32* const buffer[], void* client) {
  auto& decoding = *static_cast<Decoding*>(client);
  const FLAC__FrameHeader& header = frame->header;
  if (decoding.width == 0) decoding.width = header.channels;
  if (header.bits_per_sample != kBitsPerSample) {
    decoding.fault = "its samples are not of 16 bits";
  } else if (header.channels != decoding.width || decoding.width > decoding.max_width) {
    decoding.fault = "it has other channels than the message";
  } else if (header.blocksize > decoding.missing) {
    decoding.fault = "it has more samples than the message";
  }
  if (decoding.fault != nullptr) return FLAC__STREAM_DECODER_WRITE_STATUS_ABORT;
  for (unsigned s = 0; s < header.blocksize; ++s) {
    for (unsigned c = 0; c < decoding.width; ++c) {
      const auto sample = static_cast<std::int16_t>(buffer[c][s]);
      std::memcpy(decoding.out + sizeof(sample) * c, &sample, sizeof(sample));
    }
    decoding.out += decoding.stride_bytes;
  }
  decoding.missing -= header.blocksize;
  return FLAC__STREAM_DECODER_WRITE_STATUS_CONTINUE;
}

void NoteError(const FLAC__StreamDecoder*, FLAC__StreamDecoderErrorStatus status, void* client) {
  auto& decoding = *static_cast<Decoding*>(client);
  if (decoding.fault == nullptr) {
    decoding.fault = status == FLAC__STREAM_DECODER_ERROR_STATUS_FRAME_CRC_MISMATCH
                         ? "it does not match its checksum"
                         : "it is damaged";
  }
}

absl::Status DecodeStream(Decoding& decoding) {
  const std::unique_ptr<FLAC__StreamDecoder, decltype(&FLAC__stream_decoder_delete)> decoder(
      FLAC__stream_decoder_new(), &FLAC__stream_decoder_delete);
  if (decoder == nullptr ||
      FLAC__stream_decoder_init_stream(decoder.get(), &Read, nullptr, nullptr, nullptr, nullptr,
                                       &Write, nullptr, &NoteError,
                                       &decoding) != FLAC__STREAM_DECODER_INIT_STATUS_OK) {
    return absl::InternalError("the FLAC decoder does not start");
  }
  FLAC__stream_decoder_process_until_end_of_stream(decoder.get());
  if (decoding.fault == nullptr && decoding.missing > 0) {
    decoding.fault = "it has fewer samples than the message";
  }
  if (decoding.fault == nullptr) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("a FLAC stream is of no use: ", decoding.fault));
}

}  // namespace

absl::StatusOr<std::vector<std::string>> EncodeFlac(std::span<const std::int16_t> samples,
                                                    int channels) {
  std::vector<std::string> streams;
  for (int first = 0; first < channels; first += kFlacChannels) {
    auto stream = EncodeStream(samples, channels, first, std::min(kFlacChannels, channels - first));
    if (!stream.ok()) return stream.status();
    streams.push_back(*std::move(stream));
  }
  return streams;
}

absl::Status DecodeFlac(std::span<const std::string* const> streams, int channels,
                        std::span<char> out) {
  const std::size_t stride_bytes = sizeof(std::int16_t) * static_cast<std::size_t>(channels);
  unsigned first = 0;
  for (const std::string* stream : streams) {
    Decoding decoding;
    decoding.in = *stream;
    decoding.out = out.data() + sizeof(std::int16_t) * first;
    decoding.stride_bytes = stride_bytes;
    decoding.missing = out.size() / stride_bytes;
    decoding.max_width = static_cast<unsigned>(channels) - first;
    if (absl::Status status = DecodeStream(decoding); !status.ok()) return status;
    first += decoding.width;
  }
  if (first == static_cast<unsigned>(channels)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("the FLAC streams have ", first, " channels, the message has ", channels));
}

}  // namespace soundmap::recording
