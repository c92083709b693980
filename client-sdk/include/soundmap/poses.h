#pragma once

#include <array>
#include <cstdint>
#include <optional>

namespace soundmap {

// Lengths in metres, angles in radians, times in nanoseconds since the Unix epoch (capture time).
// Frames: `map` is the building's frame, `base_link` the robot's (on the floor, x forward, y left).

struct Vector3 {
  double x = 0.0;
  double y = 0.0;
  double z = 0.0;
};

// A pose on the flat floor; yaw counter-clockwise from x.
struct Pose2 {
  double x_m = 0.0;
  double y_m = 0.0;
  double yaw_rad = 0.0;
};

struct Box {
  Vector3 min_m;
  Vector3 max_m;
};

struct StampedPose {
  std::int64_t time_ns = 0;
  Pose2 map_from_base;
};

enum class LocalizationState { kUnknown, kTracking, kUncertain, kLost };

// Where a robot was at `time_ns`, as the server estimated it.
struct PoseEstimate {
  std::int64_t time_ns = 0;
  Pose2 map_from_base;
  // Row-major 3 x 3 covariance of (x_m, y_m, yaw_rad), if the server sent one.
  std::optional<std::array<double, 9>> covariance;
  double effective_particles = 0.0;
  LocalizationState state = LocalizationState::kUnknown;
};

}  // namespace soundmap
