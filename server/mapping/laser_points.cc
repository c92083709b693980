#include "mapping/laser_points.h"

#include <boost/unordered/unordered_flat_set.hpp>
#include <cmath>

#include "mapping/drive_limits.h"
#include "mapping/laser_lines.h"

namespace soundmap::mapping {

std::optional<LaserPoints> PointsOf(const frames::LaserScan& scan,
                                    const frames::Calibration& calibration, double min_range_m,
                                    double max_range_m, const frames::OdometryTrack& track,
                                    frames::TimeNs lag_ns, frames::TimeNs reference_ns) {
  const auto reference = track.Near(reference_ns - lag_ns, kHoldOdometry_s);
  if (!reference) return std::nullopt;
  const double increment_s = calibration.laser_time_increment_s;
  const geometry::Pose2 base_from_odom = reference->Inverse();
  const Eigen::Isometry3d& mount = calibration.base_from_laser;
  // base_link at the reference from base_link at the time of the beam.
  const auto reference_from_beam = [&](std::size_t beam) -> std::optional<geometry::Pose2> {
    const auto odom_from_base = track.Near(
        scan.stamp_ns - lag_ns + frames::NsFromSeconds(increment_s * static_cast<double>(beam)),
        kHoldOdometry_s);
    if (!odom_from_base) return std::nullopt;
    return base_from_odom * *odom_from_base;
  };

  LaserPoints result;
  result.beams = static_cast<int>(scan.range_m.size());
  if (result.beams == 0) return result;
  const bool swept = increment_s > 0.0;
  const auto begin = reference_from_beam(0);
  const auto end = reference_from_beam(scan.range_m.size() - 1);
  if (!begin || !end) return std::nullopt;
  result.laser_begin_in_base = (begin->ToIsometry() * mount).translation().head<2>().cast<float>();
  result.laser_end_in_base = (end->ToIsometry() * mount).translation().head<2>().cast<float>();
  Eigen::Isometry3d reference_from_laser = begin->ToIsometry() * mount;
  for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
    const double range_m = scan.range_m[i];
    if (!(range_m >= min_range_m && range_m <= max_range_m)) continue;  // NaN too
    if (swept) {
      const auto at_beam = reference_from_beam(i);
      if (!at_beam) return std::nullopt;
      reference_from_laser = at_beam->ToIsometry() * mount;
    }
    const double angle_rad =
        scan.start_angle_rad + static_cast<double>(i) * scan.angle_increment_rad;
    const Eigen::Vector3d point =
        reference_from_laser *
        Eigen::Vector3d(range_m * std::cos(angle_rad), range_m * std::sin(angle_rad), 0.0);
    result.point_in_base.push_back(point.head<2>().cast<float>());
    result.beam.push_back(static_cast<std::uint16_t>(i));
  }
  return result;
}

std::vector<Eigen::Vector2f> FirstPointPerSquare(const std::vector<Eigen::Vector2f>& points,
                                                 float square_m) {
  boost::unordered_flat_set<std::int64_t> taken;
  std::vector<Eigen::Vector2f> first;
  for (const Eigen::Vector2f& point : points) {
    const auto square = SquareOf(point, square_m);
    if (square && taken.insert(KeyOf(*square)).second) first.push_back(point);
  }
  return first;
}

}  // namespace soundmap::mapping
