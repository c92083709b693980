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

SyntheticRoom OfficeFloor() {
  SyntheticRoom floor{{0.0, 0.0, 40.0, 20.0}, {}};
  std::vector<Box>& walls = floor.obstacles;
  constexpr double kWall_m = 0.2;
  // Rows of rooms with the walls between them, and for each room where its door begins.
  struct Row {
    double low_m, high_m, front_m;
    std::vector<double> ends_m, doors_m;
  };
  const Row rows[] = {
      {0.0, 9.0, 9.0, {6.0, 14.5, 19.0, 29.0, 40.0}, {4.0, 7.0, 16.0, 22.5, 37.0}},
      {11.2, 20.0, 11.0, {9.5, 16.0, 26.0, 31.5, 40.0}, {1.5, 13.5, 17.0, 29.0, 34.5}}};
  for (const Row& row : rows) {
    double begin_m = 0.0;
    for (std::size_t i = 0; i < row.ends_m.size(); ++i) {
      if (row.ends_m[i] < 40.0) {
        walls.push_back({row.ends_m[i], row.low_m, row.ends_m[i] + kWall_m, row.high_m});
      }
      walls.push_back({begin_m, row.front_m, row.doors_m[i], row.front_m + kWall_m});
      begin_m = row.doors_m[i] + 1.0;
    }
    walls.push_back({begin_m, row.front_m, 40.0, row.front_m + kWall_m});
  }
  for (const Box& furniture :
       {Box{1.0, 1.0, 2.6, 1.8}, Box{10.0, 3.0, 10.6, 5.4}, Box{23.0, 0.0, 25.0, 0.6},
        Box{33.0, 4.0, 35.0, 5.0}, Box{3.0, 17.0, 6.0, 18.0}, Box{11.5, 19.4, 15.0, 20.0},
        Box{20.0, 15.0, 21.6, 15.8}, Box{36.0, 14.0, 37.0, 17.0}}) {
    walls.push_back(furniture);
  }
  return floor;
}

SyntheticRoom SymmetricFloor() {
  SyntheticRoom floor{{0.0, 0.0, 40.0, 20.0}, {}};
  for (const Box& box :
       {Box{0.0, 9.0, 8.0, 9.2}, Box{9.0, 9.0, 22.0, 9.2}, Box{23.0, 9.0, 40.0, 9.2},
        Box{12.0, 0.0, 12.2, 9.0}, Box{27.0, 0.0, 27.2, 9.0}, Box{3.0, 2.0, 4.6, 3.0}}) {
    floor.obstacles.push_back(box);
    floor.obstacles.push_back(
        {40.0 - box.max_x_m, 20.0 - box.max_y_m, 40.0 - box.min_x_m, 20.0 - box.min_y_m});
  }
  return floor;
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
