#include "sound_map/tile_blob.h"

#include <isa-l/crc.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <string_view>
#include <type_traits>
#include <vector>

#include "absl/strings/str_cat.h"
#include "sound_map/tile.h"

namespace soundmap::sound_map {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::string_view kMagic = "SMTL";
constexpr std::uint16_t kVersion = 1;
constexpr std::size_t kChecksumAt = 8;
constexpr std::size_t kHeaderBytes = 16;
constexpr int kCompressionLevel = 1;
// All 32768 voxels, each with a time and support of its own.
constexpr std::size_t kMaxPayloadBytes =
    64 + Tile::kBlocks * 64 + Tile::kVoxels * (4 + 4 + 8 + 2 + 2 + 8 + 8 + 4);

std::uint32_t Crc32c(std::string_view bytes) {
  return ~crc32_iscsi(reinterpret_cast<unsigned char*>(const_cast<char*>(bytes.data())),
                      static_cast<int>(bytes.size()), ~0u);
}

template <typename T>
void Put(std::string& bytes, T value) {
  static_assert(std::is_arithmetic_v<T>);
  bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

class Cursor {
 public:
  explicit Cursor(std::string_view bytes) : rest_(bytes) {}

  // Zero, and ok() false from then on, when the bytes end.
  template <typename T>
  T Take() {
    T value{};
    if (rest_.size() < sizeof(T)) {
      ok_ = false;
      rest_ = {};
      return value;
    }
    std::memcpy(&value, rest_.data(), sizeof(T));
    rest_.remove_prefix(sizeof(T));
    return value;
  }

  template <typename T>
  std::vector<T> TakeColumn(std::size_t count) {
    if (rest_.size() / sizeof(T) < count) {
      ok_ = false;
      rest_ = {};
      count = 0;
    }
    std::vector<T> column(count);
    if (count != 0) std::memcpy(column.data(), rest_.data(), count * sizeof(T));
    rest_.remove_prefix(count * sizeof(T));
    return column;
  }

  bool ok() const { return ok_; }
  bool empty() const { return rest_.empty(); }

 private:
  std::string_view rest_;
  bool ok_ = true;
};

absl::Status Damaged(const TileKey& key, std::string_view what) {
  return absl::DataLossError(
      absl::StrCat("the stored sound map tile ", key.x, "/", key.y, "/", key.z,
                   " is damaged: ", absl::string_view(what.data(), what.size())));
}

absl::StatusOr<std::string> Decompress(const TileBlob& blob) {
  const std::string_view bytes = blob.bytes;
  if (bytes.size() < kHeaderBytes) return Damaged(blob.key, "it is cut off");
  if (bytes.substr(0, kMagic.size()) != kMagic)
    return Damaged(blob.key, "it does not begin as a tile");
  Cursor header(bytes.substr(kMagic.size(), kHeaderBytes - kMagic.size()));
  const auto version = header.Take<std::uint16_t>();
  const auto reserved = header.Take<std::uint16_t>();
  const auto checksum = header.Take<std::uint32_t>();
  const auto payload_bytes = header.Take<std::uint32_t>();
  if (version > kVersion) {
    return absl::InvalidArgumentError(absl::StrCat("a stored sound map tile has version ", version,
                                                   "; this program reads up to ", kVersion));
  }
  if (version == 0 || reserved != 0) return Damaged(blob.key, "its header is wrong");
  if (Crc32c(bytes.substr(kChecksumAt + 4)) != checksum) {
    return Damaged(blob.key, "its checksum is wrong");
  }
  if (payload_bytes > kMaxPayloadBytes) return Damaged(blob.key, "it is too large");
  std::string payload(payload_bytes, '\0');
  const std::size_t written = ZSTD_decompress(
      payload.data(), payload.size(), bytes.data() + kHeaderBytes, bytes.size() - kHeaderBytes);
  if (ZSTD_isError(written) != 0 || written != payload.size()) {
    return Damaged(blob.key, "it does not decompress");
  }
  return payload;
}

}  // namespace

std::string SerializeTile(const Tile& tile, double voxel_size_m) {
  std::vector<float> log_odds;
  std::vector<std::uint32_t> update_count;
  std::vector<frames::TimeNs> last_update;
  std::uint64_t block_mask = 0;
  std::string voxel_masks;
  for (int b = 0; b < Tile::kBlocks; ++b) {
    const Block* block = tile.block(b);
    if (block == nullptr) continue;
    block_mask |= std::uint64_t{1} << b;
    voxel_masks.append(reinterpret_cast<const char*>(block->mask()), 8 * sizeof(std::uint64_t));
    for (int rank = 0; rank < block->size(); ++rank) {
      const Voxel voxel = tile.VoxelAt(*block, rank);
      log_odds.push_back(voxel.log_odds);
      update_count.push_back(voxel.update_count);
      last_update.push_back(voxel.last_update_ns);
    }
  }
  std::vector<frames::TimeNs> stamps = last_update;
  std::sort(stamps.begin(), stamps.end());
  stamps.erase(std::unique(stamps.begin(), stamps.end()), stamps.end());
  std::vector<std::pair<std::uint16_t, Support>> support(tile.support().begin(),
                                                         tile.support().end());
  std::sort(support.begin(), support.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });

  std::string payload;
  Put(payload, voxel_size_m);
  for (const std::uint16_t part : {tile.key().x, tile.key().y, tile.key().z, std::uint16_t{0}}) {
    Put(payload, part);
  }
  Put(payload, tile.revision());
  Put(payload, block_mask);
  payload += voxel_masks;
  for (const float value : log_odds) Put(payload, value);
  for (const std::uint32_t value : update_count) Put(payload, value);
  Put(payload, static_cast<std::uint32_t>(stamps.size()));
  for (const frames::TimeNs value : stamps) Put(payload, value);
  for (const frames::TimeNs value : last_update) {
    const auto found = std::lower_bound(stamps.begin(), stamps.end(), value);
    Put(payload, static_cast<std::uint16_t>(found - stamps.begin()));
  }
  Put(payload, static_cast<std::uint32_t>(support.size()));
  for (const auto& [voxel, heard] : support) Put(payload, voxel);
  for (const auto& [voxel, heard] : support) Put(payload, heard.first_heard_ns);
  for (const auto& [voxel, heard] : support) Put(payload, heard.last_heard_ns);
  for (const auto& [voxel, heard] : support) Put(payload, heard.count);

  std::string bytes(kMagic);
  Put(bytes, kVersion);
  Put(bytes, std::uint16_t{0});
  Put(bytes, std::uint32_t{0});
  Put(bytes, static_cast<std::uint32_t>(payload.size()));
  bytes.resize(kHeaderBytes + ZSTD_compressBound(payload.size()));
  const std::size_t compressed =
      ZSTD_compress(bytes.data() + kHeaderBytes, bytes.size() - kHeaderBytes, payload.data(),
                    payload.size(), kCompressionLevel);
  bytes.resize(kHeaderBytes + compressed);
  const std::uint32_t checksum = Crc32c(std::string_view(bytes).substr(kChecksumAt + 4));
  std::memcpy(bytes.data() + kChecksumAt, &checksum, sizeof(checksum));
  return bytes;
}

absl::StatusOr<std::shared_ptr<Tile>> ParseTile(const TileBlob& blob, double voxel_size_m) {
  const absl::StatusOr<std::string> payload = Decompress(blob);
  if (!payload.ok()) return payload.status();
  Cursor cursor(*payload);

  const auto stored_voxel_size_m = cursor.Take<double>();
  const auto x = cursor.Take<std::uint16_t>();
  const auto y = cursor.Take<std::uint16_t>();
  const auto z = cursor.Take<std::uint16_t>();
  cursor.Take<std::uint16_t>();
  const TileKey key{x, y, z};
  const auto revision = cursor.Take<std::uint64_t>();
  const auto block_mask = cursor.Take<std::uint64_t>();
  const auto masks = cursor.TakeColumn<std::uint64_t>(8 * std::popcount(block_mask));
  std::size_t voxels = 0;
  for (const std::uint64_t mask : masks) voxels += std::popcount(mask);
  const auto log_odds = cursor.TakeColumn<float>(voxels);
  const auto update_count = cursor.TakeColumn<std::uint32_t>(voxels);
  const auto stamps = cursor.TakeColumn<frames::TimeNs>(cursor.Take<std::uint32_t>());
  const auto stamp_index = cursor.TakeColumn<std::uint16_t>(voxels);
  const auto supports = cursor.Take<std::uint32_t>();
  const auto supported = cursor.TakeColumn<std::uint16_t>(supports);
  const auto first_heard = cursor.TakeColumn<frames::TimeNs>(supports);
  const auto last_heard = cursor.TakeColumn<frames::TimeNs>(supports);
  const auto heard_count = cursor.TakeColumn<std::uint32_t>(supports);
  if (!cursor.ok() || !cursor.empty()) return Damaged(blob.key, "its columns do not fit together");
  if (stamps.size() > voxels ||
      std::adjacent_find(stamps.begin(), stamps.end(), std::greater_equal<>()) != stamps.end()) {
    return Damaged(blob.key, "its times are not in order");
  }
  if (key != blob.key) {
    return absl::InvalidArgumentError(absl::StrCat("the sound map tile stored as ", blob.key.x, "/",
                                                   blob.key.y, "/", blob.key.z, " is tile ", x, "/",
                                                   y, "/", z));
  }
  if (stored_voxel_size_m != voxel_size_m) {
    return absl::InvalidArgumentError(
        absl::StrCat("a stored sound map tile has voxels of ", stored_voxel_size_m,
                     " m, but the sound map has voxels of ", voxel_size_m, " m"));
  }

  // Generation 0 is older than any map's: the writer copies the blocks before it changes them.
  auto tile = std::make_shared<Tile>(key, /*generation=*/0);
  tile->set_revision(revision);
  std::size_t i = 0;
  std::size_t mask = 0;
  for (int b = 0; b < Tile::kBlocks; ++b) {
    if (((block_mask >> b) & 1) == 0) continue;
    for (int word = 0; word < 8; ++word, ++mask) {
      for (std::uint64_t rest = masks[mask]; rest != 0; rest &= rest - 1, ++i) {
        if (!std::isfinite(log_odds[i]) || update_count[i] == 0 ||
            stamp_index[i] >= stamps.size()) {
          return Damaged(blob.key, "a voxel's fields cannot be");
        }
        const std::uint16_t stamp = stamp_index[i];
        Block::Cell& cell = tile->Touch(b, word * 64 + std::countr_zero(rest));
        cell = {log_odds[i], update_count[i], stamp};
      }
    }
  }
  tile->SetStamps(stamps);
  for (std::size_t s = 0; s < supports; ++s) {
    const int voxel = supported[s];
    const bool ascending = s == 0 || supported[s - 1] < supported[s];
    const Block* block = voxel < Tile::kVoxels ? tile->block(voxel / Block::kVoxels) : nullptr;
    if (!ascending || block == nullptr || !block->Has(voxel % Block::kVoxels) ||
        first_heard[s] > last_heard[s] || heard_count[s] == 0) {
      return Damaged(blob.key, "what it says of heard voxels cannot be");
    }
    tile->MutableSupport().emplace(supported[s],
                                   Support{first_heard[s], last_heard[s], heard_count[s]});
  }
  return tile;
}

}  // namespace soundmap::sound_map
