#include "building/point_cloud_file.h"

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <optional>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace soundmap::building {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::size_t kMaxHeaderBytes = 64 << 10;
constexpr std::uint64_t kMaxPoints = 200'000'000;
constexpr std::size_t kMaxRecordBytes = 64 << 10;

enum class NumberType {
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat32,
  kFloat64
};

std::size_t SizeOf(NumberType type) {
  switch (type) {
    case NumberType::kInt8:
    case NumberType::kUint8:
      return 1;
    case NumberType::kInt16:
    case NumberType::kUint16:
      return 2;
    case NumberType::kInt32:
    case NumberType::kUint32:
    case NumberType::kFloat32:
      return 4;
    case NumberType::kInt64:
    case NumberType::kUint64:
    case NumberType::kFloat64:
      return 8;
  }
  return 0;
}

template <typename Number>
double Read(const char* bytes) {
  Number number;
  std::memcpy(&number, bytes, sizeof number);
  return static_cast<double>(number);
}

double ReadNumber(NumberType type, const char* bytes) {
  switch (type) {
    case NumberType::kInt8:
      return Read<std::int8_t>(bytes);
    case NumberType::kUint8:
      return Read<std::uint8_t>(bytes);
    case NumberType::kInt16:
      return Read<std::int16_t>(bytes);
    case NumberType::kUint16:
      return Read<std::uint16_t>(bytes);
    case NumberType::kInt32:
      return Read<std::int32_t>(bytes);
    case NumberType::kUint32:
      return Read<std::uint32_t>(bytes);
    case NumberType::kInt64:
      return Read<std::int64_t>(bytes);
    case NumberType::kUint64:
      return Read<std::uint64_t>(bytes);
    case NumberType::kFloat32:
      return Read<float>(bytes);
    case NumberType::kFloat64:
      return Read<double>(bytes);
  }
  return 0.0;
}

// Where a record (a point) has its coordinates: the same for both file formats.
struct Coordinate {
  NumberType type = NumberType::kFloat32;
  std::size_t byte = 0;   // in a binary record
  std::size_t token = 0;  // in a line of text
};

struct Layout {
  std::array<std::optional<Coordinate>, 3> axes;
  std::size_t record_bytes = 0;
  std::size_t record_tokens = 0;
  std::optional<std::uint64_t> points;

  void AddField(absl::string_view name, NumberType type, std::size_t count) {
    const Coordinate coordinate{type, record_bytes, record_tokens};
    if (name == "x") axes[0] = coordinate;
    if (name == "y") axes[1] = coordinate;
    if (name == "z") axes[2] = coordinate;
    record_bytes += SizeOf(type) * count;
    record_tokens += count;
  }

  absl::Status Validate() const {
    if (!axes[0] || !axes[1] || !axes[2]) {
      return absl::InvalidArgumentError("the point cloud's points lack x, y or z");
    }
    if (!points)
      return absl::InvalidArgumentError("the point cloud's header lacks its point count");
    if (*points > kMaxPoints) {
      return absl::InvalidArgumentError(absl::StrCat(
          "the point cloud claims ", *points, " points, more than the limit of ", kMaxPoints));
    }
    if (record_bytes > kMaxRecordBytes) {
      return absl::InvalidArgumentError("the point cloud's points have too many fields");
    }
    return absl::OkStatus();
  }
};

absl::Status Truncated() {
  return absl::InvalidArgumentError("the point cloud ends before its last point");
}

absl::StatusOr<std::vector<Eigen::Vector3d>> NotEmpty(std::vector<Eigen::Vector3d> points) {
  if (points.empty()) return absl::InvalidArgumentError("the point cloud has no finite point");
  return points;
}

absl::StatusOr<std::vector<Eigen::Vector3d>> ReadBinaryPoints(const Layout& layout,
                                                              std::string_view data) {
  if (*layout.points > data.size() / layout.record_bytes) return Truncated();
  std::vector<Eigen::Vector3d> points;
  points.reserve(*layout.points);
  for (std::uint64_t i = 0; i < *layout.points; ++i) {
    const char* record = data.data() + i * layout.record_bytes;
    Eigen::Vector3d point;
    for (int axis = 0; axis < 3; ++axis) {
      point[axis] = ReadNumber(layout.axes[axis]->type, record + layout.axes[axis]->byte);
    }
    if (point.allFinite()) points.push_back(point);
  }
  return NotEmpty(std::move(points));
}

// Lines of text, cut off one by one; an empty line is skipped.
class Lines {
 public:
  explicit Lines(std::string_view text) : text_(text.data(), text.size()) {}

  std::optional<absl::string_view> Next() {
    while (position_ < text_.size()) {
      const std::size_t end = std::min(text_.find('\n', position_), text_.size());
      const absl::string_view line =
          absl::StripAsciiWhitespace(text_.substr(position_, end - position_));
      position_ = std::min(end + 1, text_.size());
      if (!line.empty()) return line;
    }
    return std::nullopt;
  }

  std::size_t position() const { return position_; }

 private:
  absl::string_view text_;
  std::size_t position_ = 0;
};

absl::StatusOr<std::vector<Eigen::Vector3d>> ReadTextPoints(const Layout& layout,
                                                            std::string_view data) {
  // The shortest line holds a digit and a separator for each number.
  if (*layout.points > (data.size() + 1) / (2 * layout.record_tokens)) return Truncated();
  std::vector<Eigen::Vector3d> points;
  points.reserve(*layout.points);
  Lines lines(data);
  for (std::uint64_t i = 0; i < *layout.points; ++i) {
    const auto line = lines.Next();
    if (!line) return Truncated();
    const std::vector<absl::string_view> tokens =
        absl::StrSplit(*line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
    Eigen::Vector3d point;
    for (int axis = 0; axis < 3; ++axis) {
      const std::size_t token = layout.axes[axis]->token;
      if (token >= tokens.size() || !absl::SimpleAtod(tokens[token], &point[axis])) {
        return absl::InvalidArgumentError(
            absl::StrCat("the point cloud's point ", i, " is not a line of numbers"));
      }
    }
    if (point.allFinite()) points.push_back(point);
  }
  return NotEmpty(std::move(points));
}

std::optional<NumberType> PlyType(absl::string_view name) {
  if (name == "char" || name == "int8") return NumberType::kInt8;
  if (name == "uchar" || name == "uint8") return NumberType::kUint8;
  if (name == "short" || name == "int16") return NumberType::kInt16;
  if (name == "ushort" || name == "uint16") return NumberType::kUint16;
  if (name == "int" || name == "int32") return NumberType::kInt32;
  if (name == "uint" || name == "uint32") return NumberType::kUint32;
  if (name == "float" || name == "float32") return NumberType::kFloat32;
  if (name == "double" || name == "float64") return NumberType::kFloat64;
  return std::nullopt;
}

std::optional<NumberType> PcdType(absl::string_view type, std::uint64_t bytes) {
  if (type == "F" && bytes == 4) return NumberType::kFloat32;
  if (type == "F" && bytes == 8) return NumberType::kFloat64;
  const bool is_signed = type == "I";
  if (!is_signed && type != "U") return std::nullopt;
  switch (bytes) {
    case 1:
      return is_signed ? NumberType::kInt8 : NumberType::kUint8;
    case 2:
      return is_signed ? NumberType::kInt16 : NumberType::kUint16;
    case 4:
      return is_signed ? NumberType::kInt32 : NumberType::kUint32;
    case 8:
      return is_signed ? NumberType::kInt64 : NumberType::kUint64;
    default:
      return std::nullopt;
  }
}

std::string PackFloats(std::span<const Eigen::Vector3d> points) {
  std::string packed(points.size() * 3 * sizeof(float), '\0');
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3f point = points[i].cast<float>();
    std::memcpy(packed.data() + i * 3 * sizeof(float), point.data(), 3 * sizeof(float));
  }
  return packed;
}

}  // namespace

absl::StatusOr<std::vector<Eigen::Vector3d>> ParsePly(std::string_view bytes) {
  Lines lines(bytes);
  if (lines.Next() != "ply") return absl::InvalidArgumentError("this is not a PLY file");
  Layout layout;
  std::string format;
  std::string element;
  for (;;) {
    const auto line = lines.Next();
    if (!line || lines.position() > kMaxHeaderBytes) {
      return absl::InvalidArgumentError("the PLY header has no end");
    }
    const std::vector<absl::string_view> words = absl::StrSplit(*line, ' ', absl::SkipEmpty());
    if (words[0] == "end_header") break;
    if (words[0] == "format" && words.size() >= 2) {
      format = std::string(words[1]);
    } else if (words[0] == "element" && words.size() >= 3) {
      if (element.empty() && words[1] != "vertex") {
        return absl::InvalidArgumentError(
            absl::StrCat("the PLY file's first element is '", words[1].substr(0, 40),
                         "'; only files that begin with vertex are read"));
      }
      element = std::string(words[1]);
      std::uint64_t count = 0;
      if (!absl::SimpleAtoi(words[2], &count)) {
        return absl::InvalidArgumentError("the PLY file's number of points is not a number");
      }
      if (element == "vertex") layout.points = count;
    } else if (words[0] == "property" && element == "vertex") {
      const auto type = words.size() == 3 ? PlyType(words[1]) : std::nullopt;
      if (!type) {
        return absl::InvalidArgumentError(
            absl::StrCat("the PLY file's '", line->substr(0, 80), "' is not read"));
      }
      layout.AddField(words[2], *type, 1);
    }
  }
  if (const absl::Status status = layout.Validate(); !status.ok()) return status;
  const std::string_view data = bytes.substr(lines.position());
  if (format == "ascii") return ReadTextPoints(layout, data);
  if (format == "binary_little_endian") return ReadBinaryPoints(layout, data);
  return absl::InvalidArgumentError(
      absl::StrCat("the PLY format '", format.substr(0, 40),
                   "' is not read; ascii and binary_little_endian are"));
}

absl::StatusOr<std::vector<Eigen::Vector3d>> ParsePcd(std::string_view bytes) {
  using Words = std::vector<absl::string_view>;
  Lines lines(bytes);
  Words fields, sizes, types, counts;
  Layout layout;
  std::string data_format;
  while (data_format.empty()) {
    const auto line = lines.Next();
    if (!line || lines.position() > kMaxHeaderBytes) {
      return absl::InvalidArgumentError("this is not a PCD file: its header has no DATA line");
    }
    if (line->front() == '#') continue;
    Words words = absl::StrSplit(*line, ' ', absl::SkipEmpty());
    const absl::string_view name = words[0];
    words.erase(words.begin());
    if (name == "FIELDS" || name == "COLUMNS") fields = words;
    if (name == "SIZE") sizes = words;
    if (name == "TYPE") types = words;
    if (name == "COUNT") counts = words;
    if (name == "POINTS") {
      std::uint64_t count = 0;
      if (words.size() != 1 || !absl::SimpleAtoi(words[0], &count)) {
        return absl::InvalidArgumentError("the PCD file's number of points is not a number");
      }
      layout.points = count;
    }
    if (name == "DATA") {
      if (words.size() != 1) return absl::InvalidArgumentError("the PCD file's DATA line is empty");
      data_format = std::string(words[0]);
    }
  }
  if (fields.empty() || sizes.size() != fields.size() || types.size() != fields.size() ||
      (!counts.empty() && counts.size() != fields.size())) {
    return absl::InvalidArgumentError(
        "the PCD file's FIELDS, SIZE, TYPE and COUNT lines do not match");
  }
  for (std::size_t i = 0; i < fields.size(); ++i) {
    std::uint64_t size = 0;
    std::uint64_t count = 1;
    const bool read = absl::SimpleAtoi(sizes[i], &size) &&
                      (counts.empty() || absl::SimpleAtoi(counts[i], &count));
    const auto type = read ? PcdType(types[i], size) : std::nullopt;
    if (!type || count > kMaxRecordBytes) {
      return absl::InvalidArgumentError(
          absl::StrCat("the PCD file's field '", fields[i].substr(0, 40), "' is not read"));
    }
    layout.AddField(fields[i], *type, count);
  }
  if (const absl::Status status = layout.Validate(); !status.ok()) return status;
  const std::string_view data = bytes.substr(lines.position());
  if (data_format == "ascii") return ReadTextPoints(layout, data);
  if (data_format == "binary") return ReadBinaryPoints(layout, data);
  return absl::InvalidArgumentError(absl::StrCat("the PCD format '", data_format.substr(0, 40),
                                                 "' is not read; ascii and binary are"));
}

std::string PointsToPly(std::span<const Eigen::Vector3d> points) {
  return absl::StrCat("ply\nformat binary_little_endian 1.0\nelement vertex ", points.size(),
                      "\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
                      PackFloats(points));
}

std::string PointsToPcd(std::span<const Eigen::Vector3d> points) {
  return absl::StrCat(
      "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\n"
      "TYPE F F F\nCOUNT 1 1 1\nWIDTH ",
      points.size(), "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS ", points.size(),
      "\nDATA binary\n", PackFloats(points));
}

}  // namespace soundmap::building
