#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <random>
#include <vector>

#include "frames/frames.h"
#include "mapping/mapper.h"

namespace soundmap::mapping {

struct Box {
  Eigen::Vector3d min, max;
};

// A room from the origin with boxes in it, and exact rays in it: the oracle of what a LIDAR sees
// and where surfaces are.
class BoxRoom {
 public:
  BoxRoom(const Eigen::Vector3d& size, std::vector<Box> obstacles)
      : room_{Eigen::Vector3d::Zero(), size}, obstacles_(std::move(obstacles)) {}

  static BoxRoom WithFurniture();

  // Distance to the first surface.
  double operator()(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;
  // To the nearest surface; negative outside the air (in a wall or in furniture).
  double SignedDistance(const Eigen::Vector3d& point) const;

 private:
  Box room_;
  std::vector<Box> obstacles_;
};

// A robot's drive around the room and its sensors, seen exactly or with errors.
struct DriveModel {
  double duration_s = 40.0;
  double lap_s = 40.0;
  Eigen::Vector2d centre{4.0, 3.0};
  Eigen::Vector2d radius{2.4, 1.6};
  double lidar_period_s = 0.5;
  bool swept = true;  // each turn takes the whole period
  int rings = 24;
  int columns = 240;
  double range_noise_m = 0.0;
  int laser_beams = 0;               // of a scan of the LRF all around, 20 times a second
  double laser_outlier_share = 0.0;  // readings of 20 m instead
  double laser_stamp_late_s = 0.0;
  // Odometry: part of the way and of the turn that is lost.
  double odometry_scale = 1.0;
  double odometry_yaw_scale = 1.0;
  // Instead of the ellipse, at seconds from the start.
  std::function<geometry::Pose2(double)> path;
  // What moves: distance at seconds from the start; infinite: nothing in the way.
  std::function<double(double, const Eigen::Vector3d&, const Eigen::Vector3d&)> moving;
  Eigen::Isometry3d base_from_lidar =
      Eigen::Translation3d(0.1, 0.05, 1.2) * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ());

  // Truth, at seconds from the start.
  geometry::Pose2 MapFromBase(double time_s) const;
  frames::Calibration Calibration() const;
};

inline constexpr frames::TimeNs kDriveStart_ns = 1'700'000'000'000'000'000;

// Distance from a place in `map` along a direction to what a LIDAR sees there; infinite: no return.
using World = std::function<double(const Eigen::Vector3d&, const Eigen::Vector3d&)>;

std::vector<frames::Frame> SimulateDrive(const World& world, const DriveModel& model,
                                         unsigned seed);

// A corridor of this width around a block, with door posts at equal distances on both sides and a
// few things that stand about; the drive goes around it.
BoxRoom RingCorridor(double length_m, double depth_m, double width_m);
// Counter-clockwise along the middle of the corridor at 1 m/s, from the middle of the first side,
// with rounded corners.
geometry::Pose2 AlongRing(double length_m, double depth_m, double width_m, double way_m);

// Two people, cylinders of 0.25 m radius and 1.8 m height, who walk to and fro between the places.
struct Walker {
  Eigen::Vector2d from, to;
  double period_s = 10.0;
  Eigen::Vector2d At(double time_s) const;
};
double DistanceToWalker(const Walker& walker, double time_s, const Eigen::Vector3d& origin,
                        const Eigen::Vector3d& direction);

// One instantaneous scan in base_link.
std::vector<Eigen::Vector3f> ScanInBase(const World& world, const DriveModel& model,
                                        const geometry::Pose2& map_from_base, std::mt19937& random);

}  // namespace soundmap::mapping
