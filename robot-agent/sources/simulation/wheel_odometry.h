#pragma once

#include <random>

#include "sources/simulation/scene.h"
#include "sources/simulation/trajectory.h"

namespace soundmap::simulation {

// Dead reckoning with systematic and random errors. Starts at the origin of `odom`. The random
// error of a step grows with the square root of the way driven, so that its spread at the end does
// not depend on the rate.
class WheelOdometry {
 public:
  WheelOdometry(const OdometryConfig& config, const PlanarPose& start, std::mt19937_64 engine)
      : config_(config), last_true_(start), engine_(engine) {}

  // odom_from_base after the robot went on to `map_from_base`.
  PlanarPose Step(const PlanarPose& map_from_base);

 private:
  OdometryConfig config_;
  PlanarPose last_true_, odom_from_base_;
  std::mt19937_64 engine_;
  std::normal_distribution<double> normal_;
};

}  // namespace soundmap::simulation
