#include "absl/status/status.h"
#include "mapping/floor_plan_mapper.h"

namespace soundmap::mapping {

absl::Status FloorPlanMapperConfig::Validate() const {
  const auto within = [](double value, double low, double high) {
    return value >= low && value <= high;  // false for NaN
  };
  if (!within(cell_size_m, 0.01, 1.0)) {
    return absl::InvalidArgumentError("the floor plan's cell_size_m must be from 0.01 to 1 m");
  }
  if (!within(min_range_m, 0.0, 100.0) || !within(max_range_m, 0.5, 500.0) ||
      min_range_m >= max_range_m) {
    return absl::InvalidArgumentError(
        "the floor plan's min_range_m and max_range_m must be in order, the latter from 0.5 to 500 "
        "m");
  }
  if (laser_lag_s && !within(*laser_lag_s, -1.0, 1.0)) {
    return absl::InvalidArgumentError("the floor plan's laser_lag_s must be at most 1 s");
  }
  if (!within(key_scan_distance_m, 0.01, 10.0) || !within(key_scan_angle_rad, 0.01, 4.0) ||
      key_scans_per_place < 1 || key_scans_per_place > 1000) {
    return absl::InvalidArgumentError(
        "the floor plan's key scans must be 0.01 to 10 m and 0.01 to 4 rad apart, 1 to 1000 a "
        "place");
  }
  if (!within(wall_piece_m, 0.05, 2.0) || !within(local_map_m, 1.0, 100.0) ||
      !within(stretch_m, 0.5, 50.0)) {
    return absl::InvalidArgumentError(
        "the floor plan's wall_piece_m must be from 0.05 to 2 m, local_map_m from 1 to 100 m, "
        "stretch_m from 0.5 to 50 m");
  }
  if (!within(loop_search_m, 0.0, 10.0) || !within(loop_search_per_m, 0.0, 1.0) ||
      !within(max_loop_search_m, 0.0, 50.0)) {
    return absl::InvalidArgumentError(
        "the floor plan's loop search must be at most 10 m, 1 m for each metre, and 50 m in all");
  }
  if (relaxation_passes < 0 || relaxation_passes > 100) {
    return absl::InvalidArgumentError("the floor plan's relaxation_passes must be from 0 to 100");
  }
  if (!within(max_speed_mps, 0.01, 100.0) || !within(max_turn_rate_radps, 0.01, 100.0)) {
    return absl::InvalidArgumentError(
        "the floor plan's max_speed_mps and max_turn_rate_radps must be from 0.01 to 100");
  }
  return occupancy.Validate();
}

}  // namespace soundmap::mapping
