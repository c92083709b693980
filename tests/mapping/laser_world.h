#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <limits>
#include <optional>
#include <vector>

#include "frames/frames.h"
#include "mapping/mapper.h"

namespace soundmap::mapping {

// Walls seen from above, and exact rays to them: the oracle of what an LRF sees and where walls
// are.
class LaserWorld {
 public:
  void AddWall(const Eigen::Vector2d& begin, const Eigen::Vector2d& end) {
    walls_.push_back({begin, end});
  }
  void AddBox(const Eigen::Vector2d& low, const Eigen::Vector2d& high);

  // To the first wall; infinite if there is none.
  double Range(const Eigen::Vector2d& origin, double angle_rad) const;
  double DistanceToWall(const Eigen::Vector2d& point) const;

 private:
  struct Wall {
    Eigen::Vector2d begin, end;
  };
  std::vector<Wall> walls_;
};

// A hall of 9 m x 7 m with a cupboard and a pillar.
LaserWorld FurnishedHall();
// Corridors of 2 m around a block of 26 m x 16 m, with doors set back now and then.
LaserWorld CorridorsAroundABlock();

// Corners joined by straight ways, turning on the spot at each.
struct LaserDriveModel {
  std::vector<Eigen::Vector2d> corners;
  double speed_mps = 0.6;
  double turn_rate_radps = 0.8;
  double scan_rate_hz = 10.0;
  double odometry_rate_hz = 20.0;
  int beams = 181;
  double field_of_view_rad = 3.141592653589793;
  double max_range_m = 30.0;
  double range_noise_m = 0.01;
  double time_increment_s = 0.0;
  double lag_s = 0.0;  // of the stamps of the scans
  // Odometry: the part of the way that is added, and the turn that is added for each metre.
  double odometry_scale = 0.0;
  double odometry_turn_radpm = 0.0;
  Eigen::Isometry3d base_from_laser = Eigen::Isometry3d(
      Eigen::Translation3d(0.15, -0.05, 0.4) * Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()));
  // What an odometry reading becomes; by default itself.
  std::function<geometry::Pose2(double time_s, const geometry::Pose2& odom_from_base)> spoil;
  // A further thing in the world while the drive goes on.
  std::function<double(double time_s, const Eigen::Vector2d& origin, double angle_rad)> visitor;
};

struct SimulatedLaserDrive {
  frames::Calibration calibration;
  std::vector<frames::Frame> frames;
  std::vector<StampedPose> truth;  // at the middle of each scan, by the scan's stamps
  geometry::Pose2 start;
};

SimulatedLaserDrive SimulateLaserDrive(const LaserWorld& world, const LaserDriveModel& model,
                                       unsigned seed);

}  // namespace soundmap::mapping
