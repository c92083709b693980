#include "recording/chunk_codec.h"

#include <lz4frame.h>
#include <zstd.h>

#include <memory>

#include "absl/strings/str_cat.h"

namespace soundmap::recording {
namespace {

// Sensor data hardly shrinks further at higher levels.
constexpr int kZstdLevel = 1;

absl::Status DecompressLz4(std::string_view data, std::string& records) {
  LZ4F_dctx* raw_context = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&raw_context, LZ4F_VERSION))) {
    return absl::InternalError("LZ4F_createDecompressionContext failed");
  }
  const std::unique_ptr<LZ4F_dctx, decltype(&LZ4F_freeDecompressionContext)> context(
      raw_context, &LZ4F_freeDecompressionContext);
  std::size_t written = 0;
  // More than one frame may follow another.
  while (!data.empty()) {
    std::size_t source_bytes = data.size();
    std::size_t target_bytes = records.size() - written;
    const std::size_t result = LZ4F_decompress(context.get(), records.data() + written,
                                               &target_bytes, data.data(), &source_bytes, nullptr);
    if (LZ4F_isError(result)) {
      return absl::DataLossError(absl::StrCat("lz4: ", LZ4F_getErrorName(result)));
    }
    if (source_bytes == 0 && target_bytes == 0) {
      return absl::DataLossError("lz4: more data than the chunk declares");
    }
    data.remove_prefix(source_bytes);
    written += target_bytes;
    if (data.empty() && result != 0) return absl::DataLossError("lz4: the frame is incomplete");
  }
  if (written != records.size())
    return absl::DataLossError("lz4: less data than the chunk declares");
  return absl::OkStatus();
}

}  // namespace

std::string_view CompressionName(Compression compression) {
  switch (compression) {
    case Compression::kNone:
      return "";
    case Compression::kLz4:
      return "lz4";
    case Compression::kZstd:
      return "zstd";
  }
  return "";
}

absl::Status CompressChunk(Compression compression, std::string_view records, std::string& out) {
  const std::size_t begin = out.size();
  switch (compression) {
    case Compression::kNone:
      out.append(records);
      return absl::OkStatus();
    case Compression::kLz4: {
      LZ4F_preferences_t preferences = LZ4F_INIT_PREFERENCES;
      preferences.frameInfo.contentSize = records.size();
      out.resize(begin + LZ4F_compressFrameBound(records.size(), &preferences));
      const std::size_t bytes = LZ4F_compressFrame(out.data() + begin, out.size() - begin,
                                                   records.data(), records.size(), &preferences);
      if (LZ4F_isError(bytes)) {
        return absl::InternalError(absl::StrCat("lz4: ", LZ4F_getErrorName(bytes)));
      }
      out.resize(begin + bytes);
      return absl::OkStatus();
    }
    case Compression::kZstd: {
      out.resize(begin + ZSTD_compressBound(records.size()));
      const std::size_t bytes = ZSTD_compress(out.data() + begin, out.size() - begin,
                                              records.data(), records.size(), kZstdLevel);
      if (ZSTD_isError(bytes)) {
        return absl::InternalError(absl::StrCat("zstd: ", ZSTD_getErrorName(bytes)));
      }
      out.resize(begin + bytes);
      return absl::OkStatus();
    }
  }
  return absl::InternalError("unknown compression");
}

absl::Status DecompressChunk(std::string_view compression, std::string_view data,
                             std::uint64_t uncompressed_bytes, std::string& records) {
  if (compression.empty()) {
    if (data.size() != uncompressed_bytes) {
      return absl::DataLossError(
          absl::StrCat("it holds ", data.size(), " bytes and declares ", uncompressed_bytes));
    }
    records.assign(data);
    return absl::OkStatus();
  }
  if (compression == "lz4") {
    records.resize(uncompressed_bytes);
    return DecompressLz4(data, records);
  }
  if (compression == "zstd") {
    records.resize(uncompressed_bytes);
    const std::size_t bytes =
        ZSTD_decompress(records.data(), records.size(), data.data(), data.size());
    if (ZSTD_isError(bytes)) {
      return absl::DataLossError(absl::StrCat("zstd: ", ZSTD_getErrorName(bytes)));
    }
    if (bytes != uncompressed_bytes) {
      return absl::DataLossError("zstd: less data than the chunk declares");
    }
    return absl::OkStatus();
  }
  return absl::DataLossError(absl::StrCat("its compression '",
                                          std::string(compression.substr(0, 32)),
                                          "' is not one of '', 'lz4' and 'zstd'"));
}

}  // namespace soundmap::recording
