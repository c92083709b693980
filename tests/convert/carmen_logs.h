#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "recording/drive.h"

namespace soundmap::convert {

// A path in a folder of the test's own, with nothing there.
std::string FreshPath(const std::string& name);
void WriteBytes(const std::string& path, std::string_view bytes);
std::string ReadBytes(const std::string& path);

// FLASER with these ranges as they stand.
std::string LaserLine(const std::vector<std::string>& ranges, double stamp_s,
                      std::string_view laser_pose = "1 2 0.5",
                      std::string_view base_pose = "1 2 0.5", std::string_view host = "robot",
                      double logger_s = 0.0);
std::string OdometryLine(double x_m, double y_m, double yaw_rad, double stamp_s,
                         std::string_view host = "robot", double logger_s = 0.0);
std::vector<std::string> Repeated(std::string_view range, int count);

struct Recorded {
  std::vector<foxglove::LaserScan> scans;
  std::vector<foxglove::Odometry> odometry;
  std::vector<foxglove::PoseInFrame> truth;
  std::vector<std::int64_t> log_times_ns;  // of all, in order of the file
  recording::RobotModel robot;
};
Recorded ReadRecording(const std::string& path);

}  // namespace soundmap::convert
