#pragma once

#include <string_view>

#include "sources/frame_source.h"

namespace soundmap::sources {

// How a sensor's messages stand in a recording.
struct SensorFormat {
  std::string_view topic;
  std::string_view schema;
};

constexpr SensorFormat FormatOf(Sensor sensor) {
  switch (sensor) {
    case Sensor::kAudio:
      return {"/audio", "foxglove.RawAudio"};
    case Sensor::kLidar:
      return {"/lidar/points", "foxglove.PointCloud"};
    case Sensor::kLaser:
      return {"/scan", "foxglove.LaserScan"};
    case Sensor::kOdometry:
      return {"/odom", "foxglove.Odometry"};
    case Sensor::kGap:
      return {"/session/gap", "foxglove.KeyValuePair"};
  }
  return {};
}

}  // namespace soundmap::sources
