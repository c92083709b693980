#include "recording/packed_points.h"

#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "recording/point_order.h"
#include "recording/ring_rays.h"

namespace soundmap::recording {
namespace {

using foxglove::PackedElementField;

constexpr std::uint32_t kMaxStride = 256;
constexpr int kZstdLevel = 1;
constexpr int kAxes = 3;
constexpr int kResidualBytes = 3;

// Where x, y and z stand in a point.
struct Axes {
  std::uint32_t offset[kAxes] = {};
  bool is_double = false;

  std::uint32_t bytes() const { return is_double ? sizeof(double) : sizeof(float); }

  double Read(const char* point, int axis) const {
    if (is_double) {
      double value;
      std::memcpy(&value, point + offset[axis], sizeof(value));
      return value;
    }
    float value;
    std::memcpy(&value, point + offset[axis], sizeof(value));
    return value;
  }
  // The axis at q resolutions.
  void Write(std::int64_t q, double resolution_m, int axis, char* point) const {
    const double exact = static_cast<double>(q) * resolution_m;
    if (is_double) {
      std::memcpy(point + offset[axis], &exact, sizeof(exact));
    } else {
      const auto value = static_cast<float>(exact);
      std::memcpy(point + offset[axis], &value, sizeof(value));
    }
  }
};

std::uint32_t BytesOf(PackedElementField::NumericType type) {
  switch (type) {
    case PackedElementField::UINT8:
    case PackedElementField::INT8:
      return 1;
    case PackedElementField::UINT16:
    case PackedElementField::INT16:
      return 2;
    case PackedElementField::UINT32:
    case PackedElementField::INT32:
    case PackedElementField::FLOAT32:
      return 4;
    case PackedElementField::FLOAT64:
      return 8;
    default:
      return 0;
  }
}

bool IsWhole(const foxglove::PointCloud& cloud) {
  return cloud.point_stride() > 0 && cloud.point_stride() <= kMaxStride && !cloud.data().empty() &&
         cloud.data().size() % cloud.point_stride() == 0;
}

std::optional<Axes> FindAxes(const foxglove::PointCloud& cloud) {
  Axes axes;
  int found = 0;
  for (int axis = 0; axis < kAxes; ++axis) {
    for (const PackedElementField& field : cloud.fields()) {
      if (field.name().size() != 1 || field.name()[0] != 'x' + axis) continue;
      const bool is_double = field.type() == PackedElementField::FLOAT64;
      if (!is_double && field.type() != PackedElementField::FLOAT32) return std::nullopt;
      if (found > 0 && is_double != axes.is_double) return std::nullopt;
      axes.is_double = is_double;
      axes.offset[axis] = field.offset();
      if (std::uint64_t{field.offset()} + axes.bytes() > cloud.point_stride()) return std::nullopt;
      ++found;
      break;
    }
  }
  for (int axis = 0; axis < kAxes; ++axis) {
    const std::uint32_t apart = axes.offset[axis] > axes.offset[(axis + 1) % kAxes]
                                    ? axes.offset[axis] - axes.offset[(axis + 1) % kAxes]
                                    : axes.offset[(axis + 1) % kAxes] - axes.offset[axis];
    if (apart < axes.bytes()) return std::nullopt;
  }
  return found == kAxes ? std::optional(axes) : std::nullopt;
}

// The point in resolutions; none if it is too far or not finite.
std::optional<GridPoint> ToGrid(const Axes& axes, double resolution_m, const char* point) {
  GridPoint grid;
  for (int axis = 0; axis < kAxes; ++axis) {
    const double q = std::nearbyint(axes.Read(point, axis) / resolution_m);
    if (!(std::abs(q) <= static_cast<double>(RingRays::kLimit))) return std::nullopt;
    grid[static_cast<std::size_t>(axis)] = static_cast<std::int64_t>(q);
  }
  return grid;
}

std::string Compress(std::span<const std::uint8_t> bytes) {
  std::string out(ZSTD_compressBound(bytes.size()), '\0');
  const std::size_t size =
      ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), kZstdLevel);
  out.resize(ZSTD_isError(size) ? 0 : size);
  return out;
}

// All points on the grid, or none when one of them is not exactly.
std::optional<std::vector<GridPoint>> GridPoints(const foxglove::PointCloud& cloud,
                                                 const Axes& axes, double resolution_m) {
  const std::size_t stride = cloud.point_stride();
  std::vector<GridPoint> grid(cloud.data().size() / stride);
  std::vector<char> again(stride);
  const char* point = cloud.data().data();
  for (GridPoint& out : grid) {
    const auto there = ToGrid(axes, resolution_m, point);
    if (!there) return std::nullopt;
    out = *there;
    for (int axis = 0; axis < kAxes; ++axis) {
      axes.Write(out[static_cast<std::size_t>(axis)], resolution_m, axis, again.data());
      if (std::memcmp(again.data() + axes.offset[axis], point + axes.offset[axis], axes.bytes()) !=
          0) {
        return std::nullopt;
      }
    }
    point += stride;
  }
  return grid;
}

std::uint32_t ZigZag(std::int64_t value) {
  return static_cast<std::uint32_t>((value << 1) ^ (value >> 63));
}
std::int64_t UnZigZag(std::uint32_t value) {
  return static_cast<std::int64_t>(value >> 1) ^ -static_cast<std::int64_t>(value & 1);
}

// None when a residual is too large.
std::optional<v1::RangeImage> MakeRangeImage(std::span<const GridPoint> points, bool in_rings) {
  const PointOrder order = OrderOf(points, in_rings);
  v1::RangeImage image;
  const double unit = static_cast<double>(std::int64_t{1} << RingRays::kTurnBits);
  image.set_turn_cos(static_cast<std::int32_t>(std::lround(std::cos(order.turn_rad) * unit)));
  image.set_turn_sin(static_cast<std::int32_t>(std::lround(std::sin(order.turn_rad) * unit)));
  RingRays rays(image.turn_cos(), image.turn_sin());

  const std::size_t n = points.size();
  std::vector<std::uint8_t> ring_change(n);
  std::vector<std::vector<std::uint8_t>> planes(kAxes * kResidualBytes,
                                                std::vector<std::uint8_t>(n));
  std::uint8_t last_ring = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint8_t ring = order.ring[i];
    ring_change[i] = static_cast<std::uint8_t>(ring - last_ring);
    last_ring = ring;
    if (ring == kNoReturnRing) continue;
    const GridPoint ray = rays.Ray(ring, order.steps[i]);
    const int main = RingRays::MainAxis(ray);
    const std::int64_t along = points[i][static_cast<std::size_t>(main)];
    for (int k = 0; k < kAxes; ++k) {
      const int axis = (main + k) % kAxes;
      const std::int64_t expected =
          k == 0 ? ray[static_cast<std::size_t>(main)] : RingRays::Across(ray, axis, main, along);
      const std::int64_t residual = points[i][static_cast<std::size_t>(axis)] - expected;
      if (std::abs(residual) >= 1 << 23) return std::nullopt;
      const std::uint32_t code = ZigZag(residual);
      for (int byte = 0; byte < kResidualBytes; ++byte) {
        planes[static_cast<std::size_t>(k * kResidualBytes + byte)][i] =
            static_cast<std::uint8_t>(code >> (8 * byte));
      }
    }
    rays.Keep(ring, points[i]);
  }
  image.set_rings(Compress(ring_change));
  image.set_steps(Compress(order.steps));
  for (const auto& plane : planes) image.add_planes(Compress(plane));
  return image;
}

void AddColumn(const std::string& data, std::uint32_t stride, std::uint32_t offset,
               std::uint32_t size, v1::PackedPoints& out) {
  v1::Column& column = *out.add_columns();
  column.set_offset(offset);
  column.set_size(size);
  const std::size_t n = data.size() / stride;
  std::vector<std::vector<std::uint8_t>> planes(size, std::vector<std::uint8_t>(n));
  std::uint64_t last = 0;
  const char* point = data.data() + offset;
  for (std::size_t i = 0; i < n; ++i, point += stride) {
    std::uint64_t value = 0;
    std::memcpy(&value, point, size);
    const std::uint64_t change = value - last;
    last = value;
    for (std::uint32_t byte = 0; byte < size; ++byte) {
      planes[byte][i] = static_cast<std::uint8_t>(change >> (8 * byte));
    }
  }
  for (const auto& plane : planes) column.add_planes(Compress(plane));
}

// Columns of `n` bytes each.
class ColumnReader {
 public:
  explicit ColumnReader(std::size_t n) : n_(n), context_(ZSTD_createDCtx(), &ZSTD_freeDCtx) {}

  absl::Status Read(const std::string& column, std::vector<std::uint8_t>& out) {
    out.resize(n_);
    const std::size_t size =
        ZSTD_decompressDCtx(context_.get(), out.data(), n_, column.data(), column.size());
    if (!ZSTD_isError(size) && size == n_) return absl::OkStatus();
    return absl::InvalidArgumentError("a column of points is not one byte a point");
  }

 private:
  const std::size_t n_;
  const std::unique_ptr<ZSTD_DCtx, decltype(&ZSTD_freeDCtx)> context_;
};

// Which bytes of a point are told already.
class Told {
 public:
  explicit Told(std::uint32_t stride) : told_(stride, false) {}

  // False: beyond the point, or told before.
  bool Take(std::uint64_t offset, std::uint32_t size) {
    if (offset + size > told_.size()) return false;
    const auto begin = told_.begin() + static_cast<std::ptrdiff_t>(offset);
    if (std::find(begin, begin + size, true) != begin + size) return false;
    std::fill_n(begin, size, true);
    return true;
  }
  bool Has(std::uint32_t offset) const { return told_[offset]; }
  bool All() const { return std::find(told_.begin(), told_.end(), false) == told_.end(); }

 private:
  std::vector<bool> told_;
};

absl::Status UnpackColumn(const v1::Column& column, std::uint32_t stride, ColumnReader& reader,
                          Told& told, std::span<char> data) {
  const std::uint32_t size = column.size();
  if ((size != 1 && size != 2 && size != 4 && size != 8) || !told.Take(column.offset(), size) ||
      column.planes_size() != static_cast<int>(size)) {
    return absl::InvalidArgumentError("a column of points does not fit a point");
  }
  const std::size_t n = data.size() / stride;
  std::vector<std::uint64_t> value(n, 0);
  std::vector<std::uint8_t> plane;
  for (std::uint32_t byte = 0; byte < size; ++byte) {
    const absl::Status read = reader.Read(column.planes(static_cast<int>(byte)), plane);
    if (!read.ok()) return read;
    for (std::size_t i = 0; i < n; ++i) value[i] |= std::uint64_t{plane[i]} << (8 * byte);
  }
  std::uint64_t sum = 0;
  char* point = data.data() + column.offset();
  for (std::size_t i = 0; i < n; ++i, point += stride) {
    sum += value[i];
    std::memcpy(point, &sum, size);
  }
  return absl::OkStatus();
}

absl::Status UnpackRangeImage(const v1::RangeImage& image, std::uint32_t stride,
                              ColumnReader& reader, Told& told, std::span<char> data) {
  Axes axes;
  axes.is_double = image.is_double();
  if (image.axis_offset_size() != kAxes || image.planes_size() != kAxes * kResidualBytes ||
      !RingRays::IsTurn(image.turn_cos(), image.turn_sin()) ||
      !std::isfinite(image.resolution_m())) {
    return absl::InvalidArgumentError("the range image of the points is malformed");
  }
  for (int axis = 0; axis < kAxes; ++axis) {
    axes.offset[axis] = image.axis_offset(axis);
    if (!told.Take(axes.offset[axis], axes.bytes())) {
      return absl::InvalidArgumentError("an axis does not fit a point");
    }
  }
  std::vector<std::uint8_t> rings;
  std::vector<std::uint8_t> steps;
  std::vector<std::uint8_t> planes[kAxes * kResidualBytes];
  if (absl::Status read = reader.Read(image.rings(), rings); !read.ok()) return read;
  if (absl::Status read = reader.Read(image.steps(), steps); !read.ok()) return read;
  for (int plane = 0; plane < kAxes * kResidualBytes; ++plane) {
    const absl::Status read = reader.Read(image.planes(plane), planes[plane]);
    if (!read.ok()) return read;
  }
  RingRays rays(image.turn_cos(), image.turn_sin());
  std::uint8_t ring = 0;
  char* out = data.data();
  for (std::size_t i = 0; i < rings.size(); ++i, out += stride) {
    ring = static_cast<std::uint8_t>(ring + rings[i]);
    GridPoint point{};
    if (ring != kNoReturnRing) {
      if (steps[i] > RingRays::kMaxSteps) {
        return absl::InvalidArgumentError("a point is too many steps from the last of its ring");
      }
      const GridPoint ray = rays.Ray(ring, steps[i]);
      const int main = RingRays::MainAxis(ray);
      std::int64_t along = 0;
      for (int k = 0; k < kAxes; ++k) {
        std::uint32_t code = 0;
        for (int byte = 0; byte < kResidualBytes; ++byte) {
          code |= std::uint32_t{planes[k * kResidualBytes + byte][i]} << (8 * byte);
        }
        const int axis = (main + k) % kAxes;
        const std::int64_t expected =
            k == 0 ? ray[static_cast<std::size_t>(main)] : RingRays::Across(ray, axis, main, along);
        const std::int64_t q = expected + UnZigZag(code);
        if (std::abs(q) > RingRays::kLimit) {
          return absl::InvalidArgumentError("a point lies too far away");
        }
        if (k == 0) along = q;
        point[static_cast<std::size_t>(axis)] = q;
      }
      rays.Keep(ring, point);
    }
    for (int axis = 0; axis < kAxes; ++axis) {
      axes.Write(point[static_cast<std::size_t>(axis)], image.resolution_m(), axis, out);
    }
  }
  return absl::OkStatus();
}

}  // namespace

bool SnapPoints(double resolution_m, foxglove::PointCloud& cloud) {
  if (!IsWhole(cloud)) return false;
  const auto axes = FindAxes(cloud);
  if (!axes) return false;
  std::string data = cloud.data();
  for (std::size_t at = 0; at < data.size(); at += cloud.point_stride()) {
    char* const point = data.data() + at;
    bool finite = true;
    for (int axis = 0; axis < kAxes; ++axis) finite &= std::isfinite(axes->Read(point, axis));
    const auto grid = finite ? ToGrid(*axes, resolution_m, point) : GridPoint{};
    if (!grid) return false;
    for (int axis = 0; axis < kAxes; ++axis) {
      axes->Write((*grid)[static_cast<std::size_t>(axis)], resolution_m, axis, point);
    }
  }
  *cloud.mutable_data() = std::move(data);
  return true;
}

std::optional<v1::PackedPoints> PackPoints(const foxglove::PointCloud& cloud, double resolution_m) {
  if (!IsWhole(cloud)) return std::nullopt;
  const std::string& data = cloud.data();
  const std::uint32_t stride = cloud.point_stride();
  v1::PackedPoints packed;
  packed.set_point_count(static_cast<std::uint32_t>(data.size() / stride));
  packed.set_stride(stride);
  Told told(stride);

  const auto axes = FindAxes(cloud);
  if (axes && resolution_m > 0.0) {
    if (const auto points = GridPoints(cloud, *axes, resolution_m)) {
      auto image = MakeRangeImage(*points, /*in_rings=*/true);
      auto other = MakeRangeImage(*points, /*in_rings=*/false);
      if (!image || (other && other->ByteSizeLong() < image->ByteSizeLong())) image.swap(other);
      if (image) {
        image->set_resolution_m(resolution_m);
        image->set_is_double(axes->is_double);
        for (const std::uint32_t offset : axes->offset) {
          image->add_axis_offset(offset);
          told.Take(offset, axes->bytes());
        }
        *packed.mutable_range_image() = *std::move(image);
      }
    }
  }
  for (const PackedElementField& field : cloud.fields()) {
    const std::uint32_t size = BytesOf(field.type());
    if (size > 0 && told.Take(field.offset(), size)) {
      AddColumn(data, stride, field.offset(), size, packed);
    }
  }
  for (std::uint32_t offset = 0; offset < stride; ++offset) {
    if (!told.Has(offset)) AddColumn(data, stride, offset, 1, packed);
  }
  return packed;
}

absl::Status UnpackPoints(const v1::PackedPoints& packed, std::span<char> data) {
  const std::uint32_t stride = packed.stride();
  if (stride == 0 || stride > kMaxStride || packed.columns_size() > static_cast<int>(stride) ||
      std::uint64_t{packed.point_count()} * stride != data.size() || data.empty()) {
    return absl::InvalidArgumentError("the packed points do not fit their message");
  }
  Told told(stride);
  ColumnReader reader(packed.point_count());
  for (const v1::Column& column : packed.columns()) {
    const absl::Status unpacked = UnpackColumn(column, stride, reader, told, data);
    if (!unpacked.ok()) return unpacked;
  }
  if (packed.has_range_image()) {
    const absl::Status unpacked =
        UnpackRangeImage(packed.range_image(), stride, reader, told, data);
    if (!unpacked.ok()) return unpacked;
  }
  if (told.All()) return absl::OkStatus();
  return absl::InvalidArgumentError("some bytes of the packed points are missing");
}

}  // namespace soundmap::recording
