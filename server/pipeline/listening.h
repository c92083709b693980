#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "acoustics/audio_scanner.h"
#include "frames/odometry_track.h"
#include "localization/localizer.h"
#include "pipeline/band.h"
#include "pipeline/prepared_building.h"
#include "pipeline/profile.h"
#include "pipeline/stage_times.h"
#include "ray_casting/ray_caster.h"
#include "sound_map/evidence.h"
#include "sound_map/source_register.h"

namespace soundmap::pipeline {

// One robot's drive, from frames to evidence: localization and acoustics side by side, which meet
// in ray casting. The robot is heard in the profile's band and in each of the site's bands, side by
// side: what one gives does not depend on the others. Each frame is given to Localize() and then to
// Hear(). While the robot does not know where it is, hearing waits: the frames from then on are
// given to Hear() once it knows where it was, in their order and before the next Localize(). A
// deterministic function of the frames. Strand-owned.
class Listening {
 public:
  // One audio scan that says something about the map.
  struct Scan {
    acoustics::LikelihoodScan audio;  // without its likelihoods
    localization::PoseEstimate pose;
    sound_map::EvidenceScan evidence;
    std::vector<sound_map::HeardPeak> heard;
    std::optional<sound_map::ArrayPlane> array_plane;
    std::optional<double> full_scale_spl_db;
    std::optional<Eigen::Vector3d> array_in_map_m;
    std::uint8_t band = kMainBand;  // number of the map that it is for
  };
  // What some frames led to.
  struct Output {
    std::vector<Scan> scans;  // by time, of one time by band
    std::vector<localization::PoseEstimate> path;
  };
  // Since the start of the drive. A frame or scan that could not be used is left out and counted
  // here; scans of the main band alone.
  struct Counters {
    std::int64_t audio_scans = 0;  // that gave evidence
    std::int64_t backward_odometry =
        0;  // stamps that ran backwards, or numbers that are not finite
    std::int64_t dead_microphone_scans = 0;      // audio scans that did without a dead microphone
    std::int64_t faulty_audio_scans = 0;         // a dead microphone, lost samples
    std::int64_t inverted_microphone_scans = 0;  // audio scans that mended an inverted polarity
    std::vector<int> inverted_microphones;       // of any of them, in channel order
    std::int64_t scans_without_range = 0;        // no LIDAR scan was near in time, or none at all
    std::int64_t scans_without_pose = 0;  // the robot was lost, and never learnt where it was
    std::int64_t refused_audio = 0;       // blocks that do not fit the ones before
    std::int64_t backward_lidar = 0;
    frames::TimeNs unheard_ns = 0;  // at the end of the drive, since the robot was lost
  };

  // `profile` and `clock` must outlive this; the clock (null: none) is told where the stages end.
  // Without an initial pose the robot may stand anywhere in the building. A band that the robot's
  // sample rate does not reach has no scans of it.
  static absl::StatusOr<std::unique_ptr<Listening>> Create(
      const Profile& profile, const std::vector<Band>& bands,
      const frames::Calibration& calibration, std::shared_ptr<const PreparedBuilding> building,
      const std::optional<geometry::Pose2>& initial_pose, std::uint64_t seed,
      StageClock* clock = nullptr);
  ~Listening();

  void Localize(const frames::Frame& frame, Output& output);
  // Something else than a sensor's frame comes where the next frame to hear would.
  void SkipHearing();
  // A frame given away is not copied.
  void Hear(frames::Frame&& frame, Output& output);
  void Hear(const frames::Frame& frame, Output& output) { Hear(frames::Frame(frame), output); }
  // Whether the next frame to hear must wait until the robot knows where it was.
  bool waits() const;
  // None while the robot does not know where it is.
  std::optional<localization::OdometryFrame> odometry_frame() const;
  // The frames that Hear() was given since the start of the drive.
  std::int64_t heard() const;
  // The drive is over: what waits for later frames does without them, what waits for the robot to
  // know where it was is left out.
  void Finish(Output& output);

  const Counters& counters() const;
  // Plain sentences for what the counters say, and for the bands that cannot be heard.
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
