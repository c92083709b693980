#include "frames/frames.h"

#include "absl/strings/str_cat.h"

namespace soundmap::frames {

TimeNs StampOf(const Frame& frame) {
  return std::visit([](const auto& sensor_frame) { return sensor_frame.stamp_ns; }, frame);
}

absl::Status Calibration::Validate() const {
  if (!base_from_array.matrix().allFinite() || !base_from_lidar.matrix().allFinite() ||
      !base_from_laser.matrix().allFinite()) {
    return absl::InvalidArgumentError("the calibration has a mounting that is not finite");
  }
  if (!(laser_time_increment_s >= 0.0 && laser_time_increment_s < 1.0)) {
    return absl::InvalidArgumentError(
        "the calibration's laser_time_increment_s must be from 0 to 1 second");
  }
  if (full_scale_spl_db && !(*full_scale_spl_db >= 60.0 && *full_scale_spl_db <= 200.0)) {
    return absl::InvalidArgumentError(
        "the calibration's full_scale_spl_db must be from 60 to 200 dB");
  }
  const int microphones = static_cast<int>(mic_in_array_m.size());
  if (microphones == 0) return absl::OkStatus();
  if (microphones < 2 || microphones > 64) {
    return absl::InvalidArgumentError(
        absl::StrCat("the calibration has ", microphones, " microphone(s); an array has 2 to 64"));
  }
  for (int a = 0; a < microphones; ++a) {
    if (!mic_in_array_m[a].allFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat("the calibration's position of mic_", a, " is not finite"));
    }
    for (int b = 0; b < a; ++b) {
      if ((mic_in_array_m[a] - mic_in_array_m[b]).norm() < 1e-6) {
        return absl::InvalidArgumentError(
            absl::StrCat("the calibration has mic_", b, " and mic_", a, " at the same place"));
      }
    }
  }
  if (audio_sample_rate_hz != 0 && (audio_sample_rate_hz < 8000 || audio_sample_rate_hz > 192000)) {
    return absl::InvalidArgumentError(absl::StrCat("the calibration's sample rate ",
                                                   audio_sample_rate_hz,
                                                   " Hz is outside 8000 to 192000 Hz"));
  }
  return absl::OkStatus();
}

}  // namespace soundmap::frames
