#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace soundmap::convert {

struct PlanarPose {
  double x_m = 0.0;
  double y_m = 0.0;
  double yaw_rad = 0.0;
};

struct CarmenScan {
  std::int64_t stamp_ns = 0;
  double start_angle_rad = 0.0;
  double angle_increment_rad = 0.0;
  std::vector<float> range_m;  // as logged
  double max_range_m = 0.0;    // that the line declares; 0: none
  PlanarPose laser;            // in the odometry's frame, or wherever a program has put it
  std::optional<PlanarPose> odom_from_base;
};

struct CarmenOdometry {
  std::int64_t stamp_ns = 0;
  PlanarPose odom_from_base;
};

// Of one kind of message; times increase.
struct CarmenLog {
  std::vector<CarmenScan> scans;
  std::vector<CarmenOdometry> odometry;  // of ODOM lines, else of the scans
  PlanarPose base_from_laser;
  double no_return_from_m = 0.0;  // ranges from here on are codes for "no return"

  int malformed_lines = 0;
  std::vector<int> malformed_line_numbers;  // the first of them
  int other_lasers = 0;                     // lines of rear and further lasers, left out
  int backward_scans = 0;                   // left out: not later than the one before
  int backward_odometry = 0;
};

// The front laser and the odometry of a CARMEN log, line by line: FLASER, ROBOTLASER1, RAWLASER1,
// ODOM, and PARAM robot_frontlaser_offset.
//
// Times are the ipc_timestamp, the sensor's process's own, since the logger's carries the delays of
// the network and of the logger's queue: in real logs laser periods spread over 7 ms by the one and
// over 500 ms by the other. The log's order is that of the logger, so the two kinds are not in
// order of each other. Where laser and odometry come from hosts of different clocks, the odometry
// is put on the laser's clock by the shortest delay of each to the logger.
class CarmenParser {
 public:
  void Add(std::string_view line, int number);

  // Once, after the last line. InvalidArgument: no laser line. `max_range_m`: ranges from here on
  // are "no return" whatever the log shows.
  absl::StatusOr<CarmenLog> Finish(std::optional<double> max_range_m);

 private:
  // Seconds; when the sensor's process and when the logger stamped a message.
  struct Stamp {
    double ipc_s = 0.0;
    std::string host;
    double logger_s = 0.0;
  };
  struct Clock {
    std::string host;  // empty: no message yet
    double shortest_delay_s = 0.0;
    void Add(const Stamp& stamp);
  };
  class Fields;

  bool AddLaser(Fields fields, bool declared, bool with_robot);
  bool AddFrontLaser(Fields fields);
  bool AddOdometry(Fields fields);
  static bool Read(Fields& fields, Stamp& stamp);

  CarmenLog log_;
  std::optional<double> front_laser_offset_m_;
  Clock laser_clock_;
  Clock odometry_clock_;
};

}  // namespace soundmap::convert
