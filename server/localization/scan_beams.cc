#include "localization/scan_beams.h"

#include <cmath>

namespace soundmap::localization {
namespace {

frames::TimeNs TimeOf(std::size_t beam, const frames::LaserScan& scan, double time_increment_s,
                      double lag_s) {
  return scan.stamp_ns - frames::NsFromSeconds(lag_s) +
         frames::NsFromSeconds(static_cast<double>(beam) * time_increment_s);
}

}  // namespace

frames::TimeNs MiddleOf(const frames::LaserScan& scan, double time_increment_s, double lag_s) {
  return TimeOf(scan.range_m.size() / 2, scan, time_increment_s, lag_s);
}

std::optional<std::vector<Beam>> ValidBeams(const frames::LaserScan& scan,
                                            const frames::Calibration& calibration, double lag_s,
                                            double min_range_m,
                                            const frames::OdometryTrack& track) {
  const double time_increment_s = calibration.laser_time_increment_s;
  const auto odom_from_middle = track.At(MiddleOf(scan, time_increment_s, lag_s));
  if (!odom_from_middle) return std::nullopt;
  const geometry::Pose2 middle_from_odom = odom_from_middle->Inverse();

  std::vector<Beam> beams;
  beams.reserve(scan.range_m.size());
  Eigen::Isometry3d middle_from_laser = calibration.base_from_laser;
  for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
    const double range_m = scan.range_m[i];
    if (!(range_m >= min_range_m) || !std::isfinite(range_m)) continue;
    if (time_increment_s > 0.0) {
      const auto odom_from_base = track.At(TimeOf(i, scan, time_increment_s, lag_s));
      if (!odom_from_base) return std::nullopt;
      middle_from_laser =
          (middle_from_odom * *odom_from_base).ToIsometry() * calibration.base_from_laser;
    }
    const double angle_rad =
        scan.start_angle_rad + static_cast<double>(i) * scan.angle_increment_rad;
    const Eigen::Vector3d direction =
        middle_from_laser.linear() * Eigen::Vector3d(std::cos(angle_rad), std::sin(angle_rad), 0.0);
    const double along_floor = direction.head<2>().norm();
    if (!(along_floor > 0.5)) continue;
    beams.push_back({middle_from_laser.translation().head<2>(), direction.head<2>() / along_floor,
                     range_m * along_floor});
  }
  return beams;
}

std::vector<Beam> Subsample(const std::vector<Beam>& beams, int count) {
  if (static_cast<int>(beams.size()) <= count) return beams;
  std::vector<Beam> chosen;
  chosen.reserve(count);
  for (int i = 0; i < count; ++i) {
    chosen.push_back(beams[(2 * static_cast<std::size_t>(i) + 1) * beams.size() / (2 * count)]);
  }
  return chosen;
}

}  // namespace soundmap::localization
