#include "tests/convert/carmen_logs.h"

#include <gtest/gtest.h>

#include <fstream>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "recording/reader.h"

namespace soundmap::convert {

std::string FreshPath(const std::string& name) {
  static int count = 0;
  return absl::StrCat(::testing::TempDir(), "/", ++count, "_", name);
}

void WriteBytes(const std::string& path, std::string_view bytes) {
  std::ofstream(path, std::ios::binary)
      .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

std::string ReadBytes(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

std::string LaserLine(const std::vector<std::string>& ranges, double stamp_s,
                      std::string_view laser_pose, std::string_view base_pose,
                      std::string_view host, double logger_s) {
  return absl::StrFormat("FLASER %d %s %s %s %.6f %s %.6f\n", ranges.size(),
                         absl::StrJoin(ranges, " "), std::string(laser_pose),
                         std::string(base_pose), stamp_s, std::string(host), logger_s);
}

std::string OdometryLine(double x_m, double y_m, double yaw_rad, double stamp_s,
                         std::string_view host, double logger_s) {
  return absl::StrFormat("ODOM %.6f %.6f %.6f 0 0 0 %.6f %s %.6f\n", x_m, y_m, yaw_rad, stamp_s,
                         std::string(host), logger_s);
}

std::vector<std::string> Repeated(std::string_view range, int count) {
  return std::vector<std::string>(count, std::string(range));
}

Recorded ReadRecording(const std::string& path) {
  Recorded recorded;
  const auto survey = recording::SurveyDrive(path);
  EXPECT_TRUE(survey.ok()) << survey.status();
  if (!survey.ok()) return recorded;
  EXPECT_TRUE(survey->damage.ok());
  recorded.robot = recording::MakeRobotModel(survey->transforms, 0).value();
  auto reader = recording::Reader::Open(path).value();
  for (;;) {
    const auto message = reader->Next();
    EXPECT_TRUE(message.ok());
    if (!message.ok() || !*message) return recorded;
    const recording::Message& content = **message;
    recorded.log_times_ns.push_back(content.log_time_ns);
    if (content.topic == "/scan") {
      EXPECT_TRUE(recorded.scans.emplace_back().ParseFromString(content.data));
    } else if (content.topic == "/odom") {
      EXPECT_TRUE(recorded.odometry.emplace_back().ParseFromString(content.data));
    } else if (content.topic == "/ground_truth/pose") {
      EXPECT_TRUE(recorded.truth.emplace_back().ParseFromString(content.data));
    } else {
      EXPECT_EQ(content.topic, "/tf_static");
    }
  }
}

}  // namespace soundmap::convert
