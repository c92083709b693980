#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <random>
#include <vector>

#include "sources/simulation/ray_caster.h"
#include "sources/simulation/scene.h"
#include "sources/simulation/trajectory.h"

namespace soundmap::simulation {

struct LidarScan {
  std::vector<Eigen::Vector3f> point_in_lidar;  // in the sensor's frame at the point's own time
  std::vector<std::uint32_t> time_offset_ns;    // after the start of the scan; empty if not swept
};

// 3D LIDAR: one column of rings after the other, counter-clockwise from the sensor's x axis. A beam
// without return leaves no point.
LidarScan ScanLidar(const Scene& scene, const RayCaster& rays, const Trajectory& trajectory,
                    double time_s, std::mt19937_64& engine);

// The angle of the first beam of the laser range finder; the last is at minus this.
double FirstBeamAngleRad(const LaserConfig& laser);

// Ranges of the laser range finder, instantaneous; `inf` without return.
std::vector<double> ScanLaser(const Scene& scene, const RayCaster& rays,
                              const Trajectory& trajectory, double time_s, std::mt19937_64& engine);

}  // namespace soundmap::simulation
