#include "absl/status/status.h"
#include "mapping/mapper.h"

namespace soundmap::mapping {

absl::Status MapperConfig::Validate() const {
  const auto within = [](double value, double low, double high) {
    return value >= low && value <= high;  // false for NaN
  };
  if (!within(voxel_size_m, 0.01, 1.0)) {
    return absl::InvalidArgumentError("the mapping's voxel_size_m must be from 0.01 to 1 m");
  }
  if (!within(min_range_m, 0.0, 100.0) || !within(max_range_m, 0.5, 500.0) ||
      min_range_m >= max_range_m) {
    return absl::InvalidArgumentError(
        "the mapping's min_range_m and max_range_m must be in order, the latter from 0.5 to 500 m");
  }
  if (!within(slice_half_thickness_m, 0.0, 5.0) || !within(slice_height_without_lrf_m, -100, 100) ||
      (slice_height_m && !within(*slice_height_m, -100, 100))) {
    return absl::InvalidArgumentError(
        "the mapping's slice must be within 100 m of the floor and at most 10 m thick");
  }
  if (!within(surface_voxel_size_m, 0.05, 2.0)) {
    return absl::InvalidArgumentError(
        "the mapping's surface_voxel_size_m must be from 0.05 to 2 m");
  }
  if (!within(key_scan_distance_m, 0.0, 10.0) || !within(key_scan_angle_rad, 0.0, 4.0) ||
      key_scans_per_place < 1 || key_scans_per_place > 1000) {
    return absl::InvalidArgumentError(
        "the mapping's key scans must be at most 10 m and 4 rad apart, 1 to 1000 a place");
  }
  if (relaxation_passes < 0 || relaxation_passes > 100) {
    return absl::InvalidArgumentError("the mapping's relaxation_passes must be from 0 to 100");
  }
  if (!within(max_speed_mps, 0.01, 100.0) || !within(max_turn_rate_radps, 0.01, 100.0)) {
    return absl::InvalidArgumentError(
        "the mapping's max_speed_mps and max_turn_rate_radps must be from 0.01 to 100");
  }
  return occupancy.Validate();
}

}  // namespace soundmap::mapping
