#pragma once

#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "acoustics/audio_scanner.h"
#include "building/building.h"
#include "frames/odometry_track.h"
#include "localization/localizer.h"
#include "pipeline/profile.h"
#include "ray_casting/ray_caster.h"
#include "sound_map/evidence.h"

namespace soundmap::pipeline {

// One robot's drive, from frames to evidence: localization and acoustics side by side, which meet
// in ray casting. A deterministic function of the frames in their order. Strand-owned.
class Listening {
 public:
  // One audio scan that says something about the map.
  struct Scan {
    acoustics::LikelihoodScan audio;  // without its likelihoods
    localization::PoseEstimate pose;
    sound_map::EvidenceScan evidence;
  };
  // What some frames led to.
  struct Output {
    std::vector<Scan> scans;
    std::vector<localization::PoseEstimate> path;
  };
  // Since the start of the drive. A frame or scan that could not be used is left out and counted
  // here.
  struct Counters {
    std::int64_t audio_scans = 0;  // that gave evidence
    std::int64_t backward_odometry =
        0;  // stamps that ran backwards, or numbers that are not finite
    std::int64_t faulty_audio_scans = 0;   // a dead microphone, lost samples
    std::int64_t scans_without_range = 0;  // no LIDAR scan was near in time, or none at all
    std::int64_t scans_without_pose = 0;   // the robot was lost or unknown
    std::int64_t refused_audio = 0;        // blocks that do not fit the ones before
    std::int64_t backward_lidar = 0;
  };

  // `profile` must outlive this.
  static absl::StatusOr<std::unique_ptr<Listening>> Create(
      const Profile& profile, const frames::Calibration& calibration,
      std::shared_ptr<const building::Building> building, const geometry::Pose2& initial_pose,
      std::uint64_t seed);
  ~Listening();

  void Process(const frames::Frame& frame, Output& output);
  // The drive is over: scans that wait for later frames do without them.
  void Finish(Output& output);

  const Counters& counters() const;
  // Plain sentences for what the counters say.
  std::vector<std::string> Warnings() const;

  // All that the future depends on; after RestoreState() of the same bytes the drive goes on bit
  // for bit. DataLoss: not such bytes.
  std::string SaveState() const;
  absl::Status RestoreState(const std::string& bytes);

 private:
  struct State;
  explicit Listening(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace soundmap::pipeline
