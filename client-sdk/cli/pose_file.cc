#include "cli/pose_file.h"

#include <cmath>
#include <optional>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "cli/text_file.h"

namespace soundmap::cli {
namespace {

constexpr double kMaxS = 9.2e9;  // int64 nanoseconds end in the year 2262
constexpr double kMaxCoordinateM = 1e7;
constexpr double kQuaternionTolerance = 0.01;

absl::StatusOr<std::vector<double>> Numbers(const std::vector<absl::string_view>& fields,
                                            const std::string& where) {
  std::vector<double> numbers;
  for (const absl::string_view field : fields) {
    double number = 0.0;
    if (!absl::SimpleAtod(field, &number) || !std::isfinite(number) ||
        std::abs(number) > std::max(kMaxS, kMaxCoordinateM)) {
      return absl::InvalidArgumentError(
          absl::StrCat(where, ": \"", field.substr(0, 40), "\" is not a usable number"));
    }
    numbers.push_back(number);
  }
  return numbers;
}

std::int64_t Nanoseconds(double seconds) { return std::llround(seconds * 1e9); }

std::vector<absl::string_view> SplitLine(absl::string_view line) {
  if (line.find(',') != absl::string_view::npos) {
    std::vector<absl::string_view> fields = absl::StrSplit(line, ',');
    for (absl::string_view& field : fields) field = absl::StripAsciiWhitespace(field);
    return fields;
  }
  return absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
}

bool IsHeader(const std::vector<absl::string_view>& fields) {
  return absl::ascii_isalpha(fields[0].empty() ? '0' : fields[0][0]) && fields[0] != "nan" &&
         fields[0] != "inf";
}

std::optional<double> YawOf(double x, double y, double z, double w) {
  const double norm = std::sqrt(x * x + y * y + z * z + w * w);
  if (!(std::abs(norm - 1.0) <= kQuaternionTolerance)) return std::nullopt;
  return std::atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z);
}

}  // namespace

absl::StatusOr<std::vector<StampedPose>> ReadPoseFile(const std::string& path) {
  std::vector<StampedPose> poses;
  bool first = true;
  const absl::Status status =
      ForEachLine(path, [&](absl::string_view line, const std::string& where) -> absl::Status {
        const std::vector<absl::string_view> fields = SplitLine(line);
        const bool header = first && IsHeader(fields);
        first = false;
        if (header) return absl::OkStatus();
        const bool csv = line.find(',') != absl::string_view::npos && fields.size() == 4;
        if (!csv && fields.size() != 8) {
          return absl::InvalidArgumentError(absl::StrCat(
              where, " is neither timestamp_s,x,y,yaw nor TUM's timestamp x y z qx qy qz qw"));
        }
        const auto numbers = Numbers(fields, where);
        if (!numbers.ok()) return numbers.status();
        const std::vector<double>& n = *numbers;
        StampedPose pose{.time_ns = Nanoseconds(n[0]), .map_from_base = {n[1], n[2], n[3]}};
        if (!csv) {
          const auto yaw_rad = YawOf(n[4], n[5], n[6], n[7]);
          if (!yaw_rad) {
            return absl::InvalidArgumentError(
                absl::StrCat(where, ": the quaternion does not have unit length"));
          }
          pose.map_from_base.yaw_rad = *yaw_rad;
        }
        if (!poses.empty() && pose.time_ns <= poses.back().time_ns) {
          return absl::InvalidArgumentError(
              absl::StrCat(where, ": the time is not later than that of the pose before"));
        }
        poses.push_back(pose);
        return absl::OkStatus();
      });
  if (!status.ok()) return status;
  if (poses.empty()) return absl::InvalidArgumentError(absl::StrCat(path, " holds no pose"));
  return poses;
}

absl::StatusOr<std::vector<Relation>> ReadRelationFile(const std::string& path) {
  std::vector<Relation> relations;
  const absl::Status status =
      ForEachLine(path, [&](absl::string_view line, const std::string& where) -> absl::Status {
        const std::vector<absl::string_view> fields = SplitLine(line);
        if (fields.size() != 8) {
          return absl::InvalidArgumentError(
              absl::StrCat(where, " is not of the form t1 t2 dx dy dz roll pitch yaw"));
        }
        const auto numbers = Numbers(fields, where);
        if (!numbers.ok()) return numbers.status();
        const std::vector<double>& n = *numbers;
        relations.push_back({.time1_ns = Nanoseconds(n[0]),
                             .time2_ns = Nanoseconds(n[1]),
                             .translation_m = {n[2], n[3], n[4]},
                             .roll_rad = n[5],
                             .pitch_rad = n[6],
                             .yaw_rad = n[7]});
        return absl::OkStatus();
      });
  if (!status.ok()) return status;
  if (relations.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(path, " holds no relation"));
  }
  return relations;
}

}  // namespace soundmap::cli
