#include "storage/journal_codec.h"

#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <optional>
#include <vector>

#include "absl/strings/str_cat.h"
#include "storage/bytes.h"

namespace soundmap::storage {
namespace {

using geometry::VoxelKey;
using sound_map::EndPoint;

constexpr char kVersion = 2;
constexpr char kVersionWithoutMaxima = 1;
constexpr std::size_t kMaxEndPoints = 1 << 20;
constexpr std::size_t kMaxMaxima = 1 << 16;
constexpr std::size_t kMaxSummaryBytes = 64 << 10;
constexpr std::size_t kMaxNameBytes = 63;
constexpr int kZstdLevel = 1;
constexpr std::size_t kMaxClasses = 255;  // more values than that stand as floats
constexpr VoxelKey kCentreKey = {VoxelKey::kCentre, VoxelKey::kCentre, VoxelKey::kCentre};

// A key is predicted by the one `lag` end points before it. In a lattice of directions neighbours
// lie a Fibonacci number apart, in rows 1 apart.
constexpr std::array<std::size_t, 15> kLags = {1,  2,  3,   5,   8,   13,  21, 34,
                                               55, 89, 144, 233, 377, 610, 987};

// The columns of a block; 3 bytes a varint at most, 4 a float.
constexpr std::size_t kMaxBlockBytesPerEndPoint = 3 * 3 + 4;
constexpr std::size_t kMaxBlockOverheadBytes = 64 + 4 * kMaxClasses;

const VoxelKey& Predicted(const std::vector<EndPoint>& points, std::size_t i, std::size_t lag) {
  if (i >= lag) return points[i - lag].key;
  return i > 0 ? points[i - 1].key : kCentreKey;
}

// Differences are taken modulo 2^16.
std::uint16_t ZigZagDifference(std::uint16_t value, std::uint16_t predicted) {
  const auto difference = static_cast<std::uint16_t>(value - predicted);
  return static_cast<std::uint16_t>((difference << 1) ^ -(difference >> 15));
}

int ZigZagBits(std::uint16_t value, std::uint16_t predicted) {
  return static_cast<int>(std::bit_width(ZigZagDifference(value, predicted)));
}

// Each by its difference from the one before.
void AppendMaxima(const std::vector<VoxelKey>& maxima, std::string* out) {
  AppendVarint(maxima.size(), out);
  VoxelKey last = kCentreKey;
  for (const VoxelKey& key : maxima) {
    for (const auto axis : {&VoxelKey::x, &VoxelKey::y, &VoxelKey::z}) {
      AppendVarint(ZigZagDifference(key.*axis, last.*axis), out);
    }
    last = key;
  }
}

// The lag whose differences take the fewest bits, judged by a part of the end points.
std::size_t BestLag(const std::vector<EndPoint>& points) {
  constexpr std::size_t kSamples = 128;
  const std::size_t step = std::max<std::size_t>(1, points.size() / kSamples);
  std::size_t best = kLags[0];
  std::uint64_t best_bits = std::numeric_limits<std::uint64_t>::max();
  for (const std::size_t lag : kLags) {
    std::uint64_t bits = 0;
    for (std::size_t i = 0; i < points.size(); i += step) {
      const VoxelKey& key = points[i].key;
      const VoxelKey& predicted = Predicted(points, i, lag);
      bits += ZigZagBits(key.x, predicted.x) + ZigZagBits(key.y, predicted.y) +
              ZigZagBits(key.z, predicted.z);
    }
    if (bits < best_bits) {
      best_bits = bits;
      best = lag;
    }
  }
  return best;
}

void AppendFloat(std::uint32_t float_bits, std::string* out) {
  for (int shift = 0; shift < 32; shift += 8) {
    out->push_back(static_cast<char>(float_bits >> shift));
  }
}

// The numbers of distinct likelihoods, in the order of first appearance.
class Classes {
 public:
  Classes() { slots_.fill(kNone); }

  // None if there are too many.
  std::optional<unsigned char> NumberOf(std::uint32_t float_bits) {
    std::size_t slot = (float_bits * 2654435761u) >> (32 - kSlotBits);
    for (; slots_[slot] != kNone; slot = (slot + 1) % kSlots) {
      if (values_[slots_[slot]] == float_bits) return static_cast<unsigned char>(slots_[slot]);
    }
    if (values_.size() == kMaxClasses) return std::nullopt;
    slots_[slot] = static_cast<std::uint16_t>(values_.size());
    values_.push_back(float_bits);
    return static_cast<unsigned char>(slots_[slot]);
  }

  const std::vector<std::uint32_t>& values() const { return values_; }

 private:
  static constexpr int kSlotBits = 10;
  static constexpr std::size_t kSlots = 1 << kSlotBits;  // more than kMaxClasses: one is free
  static constexpr std::uint16_t kNone = 0xffff;
  std::array<std::uint16_t, kSlots> slots_;
  std::vector<std::uint32_t> values_;
};

// The likelihoods, as classes or as floats.
void AppendLikelihoods(const std::vector<EndPoint>& points, std::string* block) {
  Classes classes;
  std::string class_of_point(points.size(), '\0');
  std::uint32_t last_bits = 0;
  unsigned char last = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto bits = std::bit_cast<std::uint32_t>(points[i].likelihood);
    if (i == 0 || bits != last_bits) {  // neighbours are alike
      const auto number = classes.NumberOf(bits);
      if (!number) {
        AppendVarint(0, block);
        for (const EndPoint& point : points) {
          AppendFloat(std::bit_cast<std::uint32_t>(point.likelihood), block);
        }
        return;
      }
      last = *number;
      last_bits = bits;
    }
    class_of_point[i] = static_cast<char>(last);
  }
  AppendVarint(classes.values().size(), block);
  for (const std::uint32_t bits : classes.values()) AppendFloat(bits, block);
  *block += class_of_point;
}

// Each number as a varint; `out` has 3 bytes a number. Returns the end of what was written.
char* WriteVarints(const std::vector<std::uint16_t>& numbers, char* out) {
  constexpr std::size_t kGroup = 16;
  const std::size_t count = numbers.size();
  std::size_t i = 0;
  while (i < count) {
    if (i + kGroup <= count) {
      // Most are below 128, a whole group at once.
      std::uint16_t any = 0;
      for (std::size_t j = 0; j < kGroup; ++j) any |= numbers[i + j];
      if (any < 0x80) {
        for (std::size_t j = 0; j < kGroup; ++j) out[j] = static_cast<char>(numbers[i + j]);
        out += kGroup;
        i += kGroup;
        continue;
      }
    }
    const std::size_t end = std::min(count, i + kGroup);
    for (; i < end; ++i) {
      std::uint16_t number = numbers[i];
      for (; number >= 0x80; number >>= 7) *out++ = static_cast<char>(number | 0x80);
      *out++ = static_cast<char>(number);
    }
  }
  return out;
}

std::string EncodeBlock(const std::vector<EndPoint>& points) {
  std::string block;
  block.reserve(points.size() * 5 + kMaxBlockOverheadBytes);
  const std::size_t lag = BestLag(points);
  AppendVarint(lag, &block);

  std::vector<std::uint16_t> differences(points.size());
  std::string column(3 * points.size(), '\0');
  const std::size_t first = std::min(lag, points.size());
  for (const auto axis : {&VoxelKey::x, &VoxelKey::y, &VoxelKey::z}) {
    for (std::size_t i = 0; i < first; ++i) {
      differences[i] = ZigZagDifference(points[i].key.*axis, Predicted(points, i, lag).*axis);
    }
    for (std::size_t i = first; i < points.size(); ++i) {
      differences[i] = ZigZagDifference(points[i].key.*axis, points[i - lag].key.*axis);
    }
    const char* const end = WriteVarints(differences, column.data());
    const auto bytes = static_cast<std::size_t>(end - column.data());
    AppendVarint(bytes, &block);
    block.append(column, 0, bytes);
  }
  AppendLikelihoods(points, &block);
  return block;
}

// What zstd needs to compress is kept: making it anew costs as much as a block.
struct Compressor {
  ZSTD_CCtx* const context = ZSTD_createCCtx();
  ~Compressor() { ZSTD_freeCCtx(context); }
};

float FloatFrom(std::string_view bytes) {
  std::uint32_t bits = 0;
  for (int i = 3; i >= 0; --i) bits = (bits << 8) | static_cast<unsigned char>(bytes[i]);
  return std::bit_cast<float>(bits);
}

absl::Status Damaged(absl::string_view what) {
  return absl::DataLossError(absl::StrCat("a journal entry is damaged: ", what));
}

absl::Status TakeMaxima(ByteSource& source, std::vector<VoxelKey>* maxima) {
  const std::uint64_t count = source.TakeVarint();
  if (count > kMaxMaxima) return Damaged("it has too many maxima");
  VoxelKey last = kCentreKey;
  for (std::uint64_t i = 0; i < count; ++i) {
    for (const auto axis : {&VoxelKey::x, &VoxelKey::y, &VoxelKey::z}) {
      const std::uint64_t difference = source.TakeVarint();
      if (!source.ok()) return Damaged("it ends early");
      if (difference > 0xffff) return Damaged("a difference of keys is beyond 16 bits");
      last.*axis = static_cast<std::uint16_t>(last.*axis + UnZigZag(difference));
    }
    maxima->push_back(last);
  }
  return absl::OkStatus();
}

absl::Status DecodeBlock(std::string_view block, std::size_t count, std::vector<EndPoint>* points) {
  ByteSource source(block);
  const std::uint64_t lag = source.TakeVarint();
  if (!source.ok() || std::find(kLags.begin(), kLags.end(), lag) == kLags.end()) {
    return Damaged("its lag is none that is used");
  }
  points->resize(count);
  for (const auto axis : {&VoxelKey::x, &VoxelKey::y, &VoxelKey::z}) {
    ByteSource column(source.Take(source.TakeVarint()));
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint64_t difference = column.TakeVarint();
      if (difference > 0xffff) return Damaged("a difference of keys is beyond 16 bits");
      (*points)[i].key.*axis =
          static_cast<std::uint16_t>(Predicted(*points, i, lag).*axis + UnZigZag(difference));
    }
    if (!column.AtEnd()) return Damaged("a column of keys has another length");
  }

  const std::uint64_t class_count = source.TakeVarint();
  if (class_count > kMaxClasses) return Damaged("it has too many classes");
  if (class_count == 0) {
    const std::string_view floats = source.Take(4 * count);
    if (!source.AtEnd()) return Damaged("its likelihoods have another length");
    for (std::size_t i = 0; i < count; ++i) {
      (*points)[i].likelihood = FloatFrom(floats.substr(4 * i, 4));
    }
    return absl::OkStatus();
  }
  const std::string_view classes = source.Take(4 * class_count);
  const std::string_view class_of_point = source.Take(count);
  if (!source.AtEnd()) return Damaged("its classes have another length");
  for (std::size_t i = 0; i < count; ++i) {
    const auto index = static_cast<unsigned char>(class_of_point[i]);
    if (index >= class_count) return Damaged("an end point is of no class");
    (*points)[i].likelihood = FloatFrom(classes.substr(4 * std::size_t{index}, 4));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::string> EncodeJournalEntry(const std::string& session,
                                               const JournalEntry& entry) {
  const std::vector<EndPoint>& points = entry.evidence.end_points;
  if (points.size() > kMaxEndPoints) {
    return absl::InvalidArgumentError(absl::StrCat("an audio scan with ", points.size(),
                                                   " end points has more than ", kMaxEndPoints));
  }
  if (entry.summary.size() > kMaxSummaryBytes) {
    return absl::InvalidArgumentError(absl::StrCat("the summary of an audio scan has ",
                                                   entry.summary.size(), " bytes, more than ",
                                                   kMaxSummaryBytes));
  }
  if (entry.evidence.maxima.size() > kMaxMaxima) {
    return absl::InvalidArgumentError(absl::StrCat(
        "an audio scan with ", entry.evidence.maxima.size(), " maxima has more than ", kMaxMaxima));
  }
  std::string value(1, kVersion);
  AppendVarint(session.size(), &value);
  value += session;
  AppendVarint(ZigZag(entry.offset), &value);
  AppendVarint(ZigZag(entry.evidence.stamp_ns), &value);
  AppendVarint(entry.summary.size(), &value);
  value += entry.summary;
  AppendMaxima(entry.evidence.maxima, &value);
  AppendVarint(points.size(), &value);
  if (points.empty()) return value;

  const std::string block = EncodeBlock(points);
  AppendVarint(block.size(), &value);
  const std::size_t head_bytes = value.size();
  value.resize(head_bytes + ZSTD_compressBound(block.size()));
  thread_local const Compressor compressor;
  const std::size_t size =
      ZSTD_compressCCtx(compressor.context, value.data() + head_bytes, value.size() - head_bytes,
                        block.data(), block.size(), kZstdLevel);
  if (ZSTD_isError(size)) {
    return absl::InternalError(
        absl::StrCat("cannot compress a journal entry: ", ZSTD_getErrorName(size)));
  }
  value.resize(head_bytes + size);
  value.shrink_to_fit();
  return value;
}

absl::Status DecodeJournalEntry(std::string_view bytes, JournalRecord* record) {
  ByteSource source(bytes);
  const std::string_view version = source.Take(1);
  if (!source.ok()) return Damaged("it is empty");
  if (version[0] != kVersion && version[0] != kVersionWithoutMaxima) {
    return absl::DataLossError(absl::StrCat("a journal entry has version ",
                                            static_cast<unsigned char>(version[0]),
                                            ", which is unknown"));
  }
  const std::string_view session = source.Take(source.TakeVarint());
  JournalEntry& entry = record->entry;
  entry.offset = UnZigZag(source.TakeVarint());
  entry.evidence.stamp_ns = UnZigZag(source.TakeVarint());
  const std::string_view summary = source.Take(source.TakeVarint());
  entry.evidence.maxima.clear();
  if (version[0] != kVersionWithoutMaxima) {
    const absl::Status taken = TakeMaxima(source, &entry.evidence.maxima);
    if (!taken.ok()) return taken;
  }
  const std::uint64_t count = source.TakeVarint();
  if (!source.ok()) return Damaged("it ends early");
  if (session.size() > kMaxNameBytes || summary.size() > kMaxSummaryBytes ||
      count > kMaxEndPoints) {
    return Damaged("a length is beyond its limit");
  }
  record->session = session;
  entry.summary = summary;
  entry.evidence.end_points.clear();
  if (count == 0) return source.AtEnd() ? absl::OkStatus() : Damaged("bytes follow its end");

  const std::uint64_t block_bytes = source.TakeVarint();
  if (!source.ok()) return Damaged("it ends early");
  if (block_bytes < 4 * count ||
      block_bytes > kMaxBlockBytesPerEndPoint * count + kMaxBlockOverheadBytes) {
    return Damaged("its length does not fit its end points");
  }
  const std::string_view compressed = source.Rest();
  std::string block(block_bytes, '\0');
  if (ZSTD_decompress(block.data(), block.size(), compressed.data(), compressed.size()) !=
      block.size()) {
    return Damaged("it does not decompress to its length");
  }
  return DecodeBlock(block, count, &entry.evidence.end_points);
}

}  // namespace soundmap::storage
