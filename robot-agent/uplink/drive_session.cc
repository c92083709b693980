#include "uplink/drive_session.h"

#include "absl/strings/str_cat.h"

namespace soundmap::uplink {
namespace {

void Set(const Eigen::Vector3d& from, v1::Vector3& to) {
  to.set_x(from.x());
  to.set_y(from.y());
  to.set_z(from.z());
}

void Set(const Eigen::Isometry3d& from, v1::Transform& to) {
  Set(from.translation(), *to.mutable_translation_m());
  const Eigen::Quaterniond rotation(from.linear());
  to.mutable_rotation()->set_x(rotation.x());
  to.mutable_rotation()->set_y(rotation.y());
  to.mutable_rotation()->set_z(rotation.z());
  to.mutable_rotation()->set_w(rotation.w());
}

}  // namespace

v1::CreateSessionRequest SessionRequest(const DriveSession& session,
                                        const sources::Replay& replay) {
  v1::CreateSessionRequest request;
  request.set_site(absl::StrCat("sites/", session.site));
  request.set_robot(absl::StrCat("robots/", session.robot));
  request.set_session_id(replay.SessionId(session.site, session.robot, session.purpose));
  const bool listening = session.purpose == "listening";
  request.set_purpose(listening ? v1::PURPOSE_LISTENING : v1::PURPOSE_MAPPING);
  v1::Calibration& calibration = *request.mutable_calibration();
  const recording::RobotModel& robot = replay.robot();
  if (robot.base_from_array) Set(*robot.base_from_array, *calibration.mutable_base_from_array());
  if (robot.base_from_lidar) Set(*robot.base_from_lidar, *calibration.mutable_base_from_lidar());
  if (robot.base_from_laser) Set(*robot.base_from_laser, *calibration.mutable_base_from_laser());
  for (const Eigen::Vector3d& mic : robot.mic_in_array_m) {
    Set(mic, *calibration.add_mic_in_array_m());
  }
  calibration.set_laser_time_increment_s(session.laser_time_increment_s);
  calibration.set_audio_sample_rate_hz(replay.survey().audio_sample_rate_hz);
  if (session.full_scale_spl_db) calibration.set_full_scale_spl_db(*session.full_scale_spl_db);
  if (!session.initial_pose.empty()) {
    request.mutable_initial_pose()->set_x_m(session.initial_pose[0]);
    request.mutable_initial_pose()->set_y_m(session.initial_pose[1]);
    request.mutable_initial_pose()->set_yaw_rad(session.initial_pose[2]);
  }
  if (listening) {
    for (const std::string& warning : replay.ListeningWarnings()) request.add_warnings(warning);
  }
  return request;
}

}  // namespace soundmap::uplink
