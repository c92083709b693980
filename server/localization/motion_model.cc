#include "localization/motion_model.h"

#include <cmath>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

// Below this the direction of a drive is noise of the wheel encoders.
constexpr double kStandstill_m = 0.002;

}  // namespace

MotionModel::MotionModel(const MotionNoise& noise, const geometry::Pose2& begin_from_end) {
  drive_m_ = std::hypot(begin_from_end.x_m, begin_from_end.y_m);
  first_turn_rad_ =
      drive_m_ < kStandstill_m ? 0.0 : std::atan2(begin_from_end.y_m, begin_from_end.x_m);
  if (std::abs(first_turn_rad_) > geometry::kPi / 2.0) {
    first_turn_rad_ = geometry::NormalizeAngle(first_turn_rad_ + geometry::kPi);
    drive_m_ = -drive_m_;
  }
  second_turn_rad_ = geometry::NormalizeAngle(begin_from_end.yaw_rad - first_turn_rad_);

  const double drive2 = drive_m_ * drive_m_;
  const double first2 = first_turn_rad_ * first_turn_rad_;
  const double second2 = second_turn_rad_ * second_turn_rad_;
  const double floor_yaw2 = noise.floor_yaw_rad * noise.floor_yaw_rad;
  const double floor_position2 = noise.floor_position_m * noise.floor_position_m;
  first_turn_std_rad_ =
      std::sqrt(noise.rotation_from_rotation * first2 + noise.rotation_from_translation * drive2);
  drive_std_m_ = std::sqrt(noise.translation_from_translation * drive2 +
                           noise.translation_from_rotation * (first2 + second2) + floor_position2);
  across_std_m_ = noise.floor_position_m;
  second_turn_std_rad_ = std::sqrt(noise.rotation_from_rotation * second2 +
                                   noise.rotation_from_translation * drive2 + floor_yaw2);
}

geometry::Pose2 MotionModel::Sample(const geometry::Pose2& map_from_base,
                                    std::mt19937_64& engine) const {
  std::normal_distribution<double> normal;
  const double first_turn_rad = first_turn_rad_ + first_turn_std_rad_ * normal(engine);
  const double drive_m = drive_m_ + drive_std_m_ * normal(engine);
  const double across_m = across_std_m_ * normal(engine);
  const double second_turn_rad = second_turn_rad_ + second_turn_std_rad_ * normal(engine);
  const double heading_rad = map_from_base.yaw_rad + first_turn_rad;
  const double c = std::cos(heading_rad);
  const double s = std::sin(heading_rad);
  return {map_from_base.x_m + drive_m * c - across_m * s,
          map_from_base.y_m + drive_m * s + across_m * c,
          geometry::NormalizeAngle(heading_rad + second_turn_rad)};
}

Eigen::Matrix3d MotionModel::Propagate(const geometry::Pose2& map_from_base,
                                       const Eigen::Matrix3d& covariance) const {
  const double heading_rad = map_from_base.yaw_rad + first_turn_rad_;
  const double c = std::cos(heading_rad);
  const double s = std::sin(heading_rad);
  Eigen::Matrix3d end_by_begin = Eigen::Matrix3d::Identity();
  end_by_begin(0, 2) = -drive_m_ * s;
  end_by_begin(1, 2) = drive_m_ * c;
  // By first turn, drive, across, second turn.
  Eigen::Matrix<double, 3, 4> end_by_noise;
  end_by_noise << -drive_m_ * s, c, -s, 0.0,  //
      drive_m_ * c, s, c, 0.0,                //
      1.0, 0.0, 0.0, 1.0;
  const Eigen::Vector4d std(first_turn_std_rad_, drive_std_m_, across_std_m_, second_turn_std_rad_);
  const Eigen::Matrix<double, 3, 4> scaled = end_by_noise * std.asDiagonal();
  return end_by_begin * covariance * end_by_begin.transpose() + scaled * scaled.transpose();
}

}  // namespace soundmap::localization
