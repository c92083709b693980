#include "sources/simulation/scanners.h"

#include <cmath>
#include <limits>
#include <numbers>

namespace soundmap::simulation {
namespace {

constexpr double kShortestM = 0.02;

}  // namespace

LidarScan ScanLidar(const Scene& scene, const RayCaster& rays, const Trajectory& trajectory,
                    double time_s, std::mt19937_64& engine) {
  const LidarConfig& lidar = scene.lidar;
  std::normal_distribution<double> noise_m(0.0, lidar.range_noise_m);
  std::uniform_real_distribution<double> chance(0.0, 1.0);
  const double turn_s = 1.0 / lidar.rate_hz;
  LidarScan scan;
  Eigen::Isometry3d map_from_lidar = trajectory.At(time_s).map_from_base() * lidar.base_from_lidar;
  std::vector<Box> people = PeopleAt(scene.people, time_s);
  for (int step = 0; step < lidar.azimuth_steps; ++step) {
    const double azimuth_rad = 2.0 * std::numbers::pi * step / lidar.azimuth_steps;
    const double offset_s = lidar.swept ? turn_s * step / lidar.azimuth_steps : 0.0;
    if (lidar.swept) {
      map_from_lidar = trajectory.At(time_s + offset_s).map_from_base() * lidar.base_from_lidar;
      people = PeopleAt(scene.people, time_s + offset_s);
    }
    for (double elevation_rad : lidar.ring_elevation_rad) {
      const Eigen::Vector3d direction(std::cos(azimuth_rad) * std::cos(elevation_rad),
                                      std::sin(azimuth_rad) * std::cos(elevation_rad),
                                      std::sin(elevation_rad));
      const double range_m =
          rays.RangeM(map_from_lidar.translation(), map_from_lidar.linear() * direction, people);
      const double measured_m = range_m + (lidar.range_noise_m > 0.0 ? noise_m(engine) : 0.0);
      const bool dropped = chance(engine) < lidar.dropout_rate;
      if (dropped || range_m > lidar.max_range_m || measured_m < kShortestM) continue;
      scan.point_in_lidar.push_back((measured_m * direction).cast<float>());
      if (lidar.swept) {
        scan.time_offset_ns.push_back(static_cast<std::uint32_t>(std::llround(offset_s * 1e9)));
      }
    }
  }
  return scan;
}

double FirstBeamAngleRad(const LaserConfig& laser) { return -laser.field_of_view_rad / 2.0; }

std::vector<double> ScanLaser(const Scene& scene, const RayCaster& rays,
                              const Trajectory& trajectory, double time_s,
                              std::mt19937_64& engine) {
  const LaserConfig& laser = scene.laser;
  std::normal_distribution<double> noise_m(0.0, laser.range_noise_m);
  std::uniform_real_distribution<double> chance(0.0, 1.0);
  std::uniform_real_distribution<double> anything_m(
      0.0, std::min(laser.max_range_m, scene.room_m.head<2>().norm()));
  const Eigen::Isometry3d map_from_laser =
      trajectory.At(time_s).map_from_base() * laser.base_from_laser;
  const std::vector<Box> people = PeopleAt(scene.people, time_s);
  const double first_rad = FirstBeamAngleRad(laser);
  std::vector<double> ranges_m;
  for (int beam = 0; beam < laser.beams; ++beam) {
    const double angle_rad = first_rad + laser.field_of_view_rad * beam / (laser.beams - 1);
    const Eigen::Vector3d direction(std::cos(angle_rad), std::sin(angle_rad), 0.0);
    const double range_m =
        rays.RangeM(map_from_laser.translation(), map_from_laser.linear() * direction, people);
    double measured_m = range_m + (laser.range_noise_m > 0.0 ? noise_m(engine) : 0.0);
    const bool dropped = chance(engine) < laser.dropout_rate;
    if (dropped || range_m > laser.max_range_m)
      measured_m = std::numeric_limits<double>::infinity();
    if (chance(engine) < laser.bad_beam_rate) measured_m = anything_m(engine);
    ranges_m.push_back(std::max(measured_m, kShortestM));
  }
  return ranges_m;
}

}  // namespace soundmap::simulation
