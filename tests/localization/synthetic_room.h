#pragma once

#include <random>
#include <vector>

#include "building/floor_plan.h"
#include "frames/frames.h"

namespace soundmap::localization {

// A room of straight walls whose ranges follow from the intersection of lines, without cells.
struct Box {
  double min_x_m, min_y_m, max_x_m, max_y_m;
};

struct SyntheticRoom {
  Box room{0.0, 0.0, 8.0, 6.0};
  std::vector<Box> obstacles{{3.0, 2.5, 5.0, 3.5}, {0.0, 4.5, 1.0, 6.0}};

  // Along a ray that begins in the room and outside the obstacles.
  double Range(double x_m, double y_m, double angle_rad) const;

  // Occupied around the room and in the obstacles, free in the room. The walls lie on edges of
  // cells.
  building::FloorPlan Plan(double cell_size_m = 0.05) const;
};

// A floor of 40 x 20 m: two rows of rooms of different sizes with doors to a corridor between them,
// and some furniture.
SyntheticRoom OfficeFloor();

// The same turned by half a turn about its middle, (20, 10): a robot cannot know which way round it
// is.
SyntheticRoom SymmetricFloor();

inline constexpr int kScanBeams = 271;
inline constexpr double kScanStart_rad = -2.356194490192345;
inline constexpr double kScanIncrement_rad = 0.017453292519943295;

frames::Calibration LaserInFront();

// What LaserInFront() sees at a pose, instantaneous.
frames::LaserScan ScanAt(const SyntheticRoom& room, const geometry::Pose2& map_from_base,
                         frames::TimeNs stamp_ns, double range_std_m, std::mt19937_64& engine);

// Laps around the middle obstacle at 0.5 m/s; true pose `time_s` after the start.
geometry::Pose2 LapPose(double time_s);

}  // namespace soundmap::localization
