#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::convert {

struct ConvertOptions {
  // Ranges from here on are "no return"; none: told from the log.
  std::optional<double> max_range_m;
  double laser_height_m = 0.3;  // above the floor; CARMEN logs do not say
  // Poses `timestamp_s,x,y,yaw` to go along as /ground_truth/pose; empty: none.
  std::string truth_path;
  bool truth_is_of_laser = false;  // instead of base_link
};

struct ConvertResult {
  std::int64_t scans = 0;
  std::int64_t odometry = 0;
  std::int64_t truth_poses = 0;
  int beams = 0;  // of the first scan
  double duration_s = 0.0;
  std::int64_t no_return_beams = 0;
  double no_return_from_m = 0.0;
  // What was left out, a sentence each.
  std::vector<std::string> warnings;
  // DataLoss: the log is damaged, and the recording holds what came before.
  absl::Status damage;
};

// Makes a recording of a CARMEN log (plain or compressed): /tf_static with base_link -> laser,
// /scan, /odom. The log is held in memory. Nothing is written unless the log has a laser line; a
// file that exists and is not empty is not overwritten.
absl::StatusOr<ConvertResult> Convert(const std::string& log_path, const std::string& out_path,
                                      const ConvertOptions& options = {});

}  // namespace soundmap::convert
