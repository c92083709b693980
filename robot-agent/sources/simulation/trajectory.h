#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "absl/status/statusor.h"
#include "sources/simulation/scene.h"

namespace soundmap::simulation {

// Robot pose on the floor, map_from_base.
struct PlanarPose {
  double x_m = 0.0;
  double y_m = 0.0;
  double yaw_rad = 0.0;  // continuous, not wrapped

  Eigen::Isometry3d map_from_base() const;
};

// Where the robot is at each time: the polygon through the way points with its corners rounded
// (moving averages along the line, so that the path stays inside the polygon's hull), heading along
// the path, speed bounded by the way points' speeds, by the acceleration and by the yaw rate.
// Starts and ends at rest.
class Trajectory {
 public:
  // InvalidArgument without way points, or if the drive would be endless or longer than a day.
  static absl::StatusOr<Trajectory> Create(const PathConfig& path, double laps);

  double duration_s() const { return duration_s_; }
  // Before the start and after the end the robot stands.
  PlanarPose At(double time_s) const;

 private:
  struct Knot {
    double time_s = 0.0;
    PlanarPose pose;
    double speed_mps = 0.0;  // grows or falls evenly to the next knot's
  };
  Trajectory() = default;

  std::vector<Knot> knots_;
  double duration_s_ = 0.0;
};

}  // namespace soundmap::simulation
