#include "pipeline/archive.h"

#include "pipeline/serialization.h"

namespace soundmap::pipeline {

std::string EncodePose(const localization::PoseEstimate& pose) { return ToBytes(pose); }

std::string EncodeAudioScan(const AudioScanInfo& scan) {
  return ToBytes(scan.robot, scan.pose, scan.noise_floor, scan.peaks, scan.end_points);
}

absl::StatusOr<localization::PoseEstimate> DecodePose(const std::string& bytes) {
  localization::PoseEstimate pose;
  const absl::Status status = FromBytes(bytes, pose);
  if (!status.ok()) return status;
  return pose;
}

absl::StatusOr<AudioScanInfo> DecodeAudioScan(const std::string& bytes) {
  AudioScanInfo scan;
  const absl::Status status =
      FromBytes(bytes, scan.robot, scan.pose, scan.noise_floor, scan.peaks, scan.end_points);
  if (!status.ok()) return status;
  return scan;
}

}  // namespace soundmap::pipeline
