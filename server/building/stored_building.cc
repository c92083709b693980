#include "building/stored_building.h"

#include <octomap/OcTree.h>
#include <zstd.h>

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>

#include "absl/strings/str_cat.h"
#include "building/octree_file.h"

namespace soundmap::building {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::string_view kMagic = "SMBUILDG";
constexpr std::uint32_t kVersion = 1;
constexpr std::size_t kPrefixBytes = 16;
constexpr std::size_t kMaxContentBytes = std::size_t{2} << 30;
constexpr int kCompressionLevel = 3;
// Of zstd: a block takes four bytes or more. No room is made for content that cannot be there.
constexpr std::size_t kMaxRatio = ZSTD_BLOCKSIZE_MAX / 4;

template <typename Number>
void Append(std::string& bytes, Number number) {
  bytes.append(reinterpret_cast<const char*>(&number), sizeof number);
}

// Takes the next bytes off the front; once they do not suffice, everything is zero and ok() is
// false.
class Cursor {
 public:
  explicit Cursor(std::string_view bytes) : rest_(bytes) {}

  template <typename Number>
  Number Take() {
    Number number{};
    const std::string_view bytes = TakeBytes(sizeof number);
    if (ok_) std::memcpy(&number, bytes.data(), sizeof number);
    return number;
  }

  std::string_view TakeBytes(std::uint64_t count) {
    if (!ok_ || count > rest_.size()) {
      ok_ = false;
      return {};
    }
    const std::string_view bytes = rest_.substr(0, count);
    rest_.remove_prefix(count);
    return bytes;
  }

  bool ok() const { return ok_; }
  bool at_end() const { return ok_ && rest_.empty(); }

 private:
  std::string_view rest_;
  bool ok_ = true;
};

absl::Status Damaged() { return absl::DataLossError("the stored building is damaged"); }

absl::StatusOr<std::string> Decompress(std::string_view frame) {
  const unsigned long long size = ZSTD_getFrameContentSize(frame.data(), frame.size());
  if (size == ZSTD_CONTENTSIZE_ERROR || size == ZSTD_CONTENTSIZE_UNKNOWN ||
      size > kMaxContentBytes || size / kMaxRatio > frame.size()) {
    return Damaged();
  }
  std::string content(size, '\0');
  const std::size_t written =
      ZSTD_decompress(content.data(), content.size(), frame.data(), frame.size());
  if (ZSTD_isError(written) || written != size) return Damaged();
  return content;
}

}  // namespace

std::string SerializeBuilding(const Building& building) {
  const FloorPlan& plan = building.floor_plan;
  const std::string octree = building.octree ? OctreeToOt(*building.octree) : std::string();
  std::string content;
  Append(content, std::uint64_t{octree.size()});
  content += octree;
  Append(content, std::int32_t{plan.width()});
  Append(content, std::int32_t{plan.height()});
  Append(content, plan.cell_size_m());
  Append(content, plan.origin_in_map_m().x());
  Append(content, plan.origin_in_map_m().y());
  content.append(reinterpret_cast<const char*>(plan.cells().data()), plan.cells().size());

  std::string bytes(kMagic);
  Append(bytes, kVersion);
  Append(bytes, std::uint32_t{0});
  bytes.resize(kPrefixBytes + ZSTD_compressBound(content.size()));
  const std::unique_ptr<ZSTD_CCtx, decltype(&ZSTD_freeCCtx)> context(ZSTD_createCCtx(),
                                                                     &ZSTD_freeCCtx);
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_compressionLevel, kCompressionLevel);
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_checksumFlag, 1);
  // Cannot fail: the destination has the bound's size.
  const std::size_t written =
      ZSTD_compress2(context.get(), bytes.data() + kPrefixBytes, bytes.size() - kPrefixBytes,
                     content.data(), content.size());
  bytes.resize(kPrefixBytes + written);
  return bytes;
}

absl::StatusOr<Building> ParseBuilding(std::string_view bytes) {
  Cursor prefix(bytes.substr(0, kPrefixBytes));
  const std::string_view magic = prefix.TakeBytes(kMagic.size());
  const auto version = prefix.Take<std::uint32_t>();
  prefix.Take<std::uint32_t>();
  if (!prefix.ok() || magic != kMagic) {
    return absl::DataLossError("the stored building does not begin as one");
  }
  if (version != kVersion) {
    return absl::UnimplementedError(absl::StrCat("the stored building has the format version ",
                                                 version, "; this program reads version ",
                                                 kVersion));
  }
  const auto content = Decompress(bytes.substr(kPrefixBytes));
  if (!content.ok()) return content.status();

  Cursor cursor(*content);
  Building building;
  const std::string_view octree_bytes = cursor.TakeBytes(cursor.Take<std::uint64_t>());
  if (!octree_bytes.empty()) {
    auto octree = ParseOctree(octree_bytes);
    if (!octree.ok()) return absl::DataLossError(octree.status().message());
    building.octree = *std::move(octree);
  }
  const auto width = cursor.Take<std::int32_t>();
  const auto height = cursor.Take<std::int32_t>();
  const auto cell_size_m = cursor.Take<double>();
  const auto x_m = cursor.Take<double>();
  const auto y_m = cursor.Take<double>();
  if (!cursor.ok() || width < 0 || height < 0 || !std::isfinite(cell_size_m) || cell_size_m <= 0 ||
      !std::isfinite(x_m) || !std::isfinite(y_m)) {
    return Damaged();
  }
  const std::string_view cells =
      cursor.TakeBytes(static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(height));
  if (!cursor.at_end()) return Damaged();
  building.floor_plan = FloorPlan(width, height, cell_size_m, Eigen::Vector2d(x_m, y_m));
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const auto cell =
          static_cast<std::uint8_t>(cells[static_cast<std::size_t>(row) * width + column]);
      if (cell > static_cast<std::uint8_t>(Cell::kOccupied)) return Damaged();
      building.floor_plan.at(column, row) = static_cast<Cell>(cell);
    }
  }
  return building;
}

}  // namespace soundmap::building
