#include "synthetic_room.h"

#include <cmath>
#include <limits>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Where a line is between two bounds, as an interval of its parameter.
void Clip(double start, double direction, double min, double max, double& enter, double& leave) {
  if (direction == 0.0) {
    if (start < min || start > max) enter = kInfinity;
    return;
  }
  const double a = (min - start) / direction;
  const double b = (max - start) / direction;
  enter = std::max(enter, std::min(a, b));
  leave = std::min(leave, std::max(a, b));
}

bool Inside(const Box& box, double x_m, double y_m) {
  return x_m > box.min_x_m && x_m < box.max_x_m && y_m > box.min_y_m && y_m < box.max_y_m;
}

}  // namespace

double SyntheticRoom::Range(double x_m, double y_m, double angle_rad) const {
  const double dx = std::cos(angle_rad);
  const double dy = std::sin(angle_rad);
  double enter = -kInfinity;
  double range_m = kInfinity;
  Clip(x_m, dx, room.min_x_m, room.max_x_m, enter, range_m);
  Clip(y_m, dy, room.min_y_m, room.max_y_m, enter, range_m);
  for (const Box& box : obstacles) {
    enter = 0.0;
    double leave = kInfinity;
    Clip(x_m, dx, box.min_x_m, box.max_x_m, enter, leave);
    Clip(y_m, dy, box.min_y_m, box.max_y_m, enter, leave);
    if (enter < leave) range_m = std::min(range_m, enter);
  }
  return range_m;
}

building::FloorPlan SyntheticRoom::Plan(double cell_size_m) const {
  constexpr double kWall_m = 0.4;
  const double left_m = room.min_x_m - kWall_m;
  const double low_m = room.min_y_m - kWall_m;
  const int width = static_cast<int>(std::lround((room.max_x_m + kWall_m - left_m) / cell_size_m));
  const int height = static_cast<int>(std::lround((room.max_y_m + kWall_m - low_m) / cell_size_m));
  building::FloorPlan plan(width, height, cell_size_m, {left_m, low_m});
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const double x_m = left_m + (column + 0.5) * cell_size_m;
      const double y_m = low_m + (row + 0.5) * cell_size_m;
      bool free = Inside(room, x_m, y_m);
      for (const Box& box : obstacles) free = free && !Inside(box, x_m, y_m);
      plan.at(column, row) = free ? building::Cell::kFree : building::Cell::kOccupied;
    }
  }
  return plan;
}

frames::Calibration LaserInFront() {
  frames::Calibration calibration;
  calibration.base_from_laser.translation() << 0.2, 0.0, 0.3;
  return calibration;
}

frames::LaserScan ScanAt(const SyntheticRoom& room, const geometry::Pose2& map_from_base,
                         frames::TimeNs stamp_ns, double range_std_m, std::mt19937_64& engine) {
  std::normal_distribution<double> noise_m(0.0, range_std_m > 0.0 ? range_std_m : 1.0);
  frames::LaserScan scan{stamp_ns, kScanStart_rad, kScanIncrement_rad, {}};
  const double x_m = map_from_base.x_m + 0.2 * std::cos(map_from_base.yaw_rad);
  const double y_m = map_from_base.y_m + 0.2 * std::sin(map_from_base.yaw_rad);
  for (int i = 0; i < kScanBeams; ++i) {
    const double angle_rad = map_from_base.yaw_rad + kScanStart_rad + i * kScanIncrement_rad;
    double range_m = room.Range(x_m, y_m, angle_rad);
    if (range_std_m > 0.0) range_m += noise_m(engine);
    scan.range_m.push_back(static_cast<float>(range_m));
  }
  return scan;
}

geometry::Pose2 LapPose(double time_s) {
  constexpr double kRadius_x_m = 2.4;
  constexpr double kRadius_y_m = 1.6;
  const double phase_rad = 0.5 / 2.0 * time_s;
  return {4.0 + kRadius_x_m * std::cos(phase_rad), 3.0 + kRadius_y_m * std::sin(phase_rad),
          std::atan2(kRadius_y_m * std::cos(phase_rad), -kRadius_x_m * std::sin(phase_rad))};
}

}  // namespace soundmap::localization
