#include "pipeline/trial.h"

#include <nlohmann/json.hpp>
#include <utility>

#include "pipeline/drive_log.h"
#include "pipeline/listening.h"
#include "sound_map/sound_map.h"
#include "sound_map/sound_sources.h"
#include "sound_map/source_register.h"
#include "storage/crc32c.h"

namespace soundmap::pipeline {
namespace {

// A sound map and its sources, without a store.
class TrialMap {
 public:
  explicit TrialMap(std::unique_ptr<sound_map::SoundMap> map)
      : map_(std::move(map)), register_(map_->config()), finder_(map_->config().sources) {}

  absl::Status Apply(const std::string& robot, const Listening::Scan& scan) {
    const absl::Status applied = map_->Apply(scan.evidence);
    if (!applied.ok()) return applied;
    const geometry::Pose2& pose = scan.pose.map_from_base;
    register_.Observe({robot,
                       {pose.x_m, pose.y_m},
                       &scan.evidence,
                       &scan.heard,
                       scan.array_plane,
                       scan.full_scale_spl_db,
                       scan.array_in_map_m});
    if (register_.due()) Update();
    return absl::OkStatus();
  }

  std::vector<sound_map::RegisteredSource> Sources() {
    if (register_.pending()) Update();
    std::vector<sound_map::RegisteredSource> sources = register_.Sources();
    std::erase_if(sources, [](const sound_map::RegisteredSource& source) {
      return source.state == sound_map::SourceState::kGone;
    });
    return sources;
  }

 private:
  void Update() { register_.Update(finder_.Find(map_->Present())); }

  const std::unique_ptr<sound_map::SoundMap> map_;
  sound_map::SourceRegister register_;
  sound_map::SourceFinder finder_;
};

// One drive through the pipeline. What a lost robot heard waits in the log until it knows where it
// was, and enters the map before it drives on, as in a session.
class Drive {
 public:
  Drive(const DriveLog& log, const std::string& robot, Listening* listening, TrialMap* map)
      : log_(log), robot_(robot), listening_(listening), map_(map) {}

  // `frame_done(offset)` says whether to go on.
  absl::Status Run(absl::FunctionRef<bool(std::int64_t offset)> frame_done) {
    auto reader = log_.Read();
    if (!reader.ok()) return reader.status();
    for (std::int64_t offset = 0; offset < log_.frame_count(); ++offset) {
      const absl::Status caught_up = CatchUp(offset);
      if (!caught_up.ok()) return caught_up;
      auto frame = reader->Next();
      if (!frame.ok()) return frame.status();
      Listening::Output output;
      if (*frame) listening_->Localize(**frame, output);
      if (listening_->heard() == offset && !listening_->waits()) Hear(*std::move(frame), output);
      const absl::Status taken = Take(output);
      if (!taken.ok()) return taken;
      if (!frame_done(offset)) return absl::CancelledError("the trial was cancelled");
    }
    const absl::Status caught_up = CatchUp(log_.frame_count());
    if (!caught_up.ok()) return caught_up;
    Listening::Output output;
    listening_->Finish(output);
    return Take(output);
  }

 private:
  absl::Status CatchUp(std::int64_t localized) {
    if (listening_->heard() == localized || listening_->waits()) return absl::OkStatus();
    auto unheard = log_.Read(listening_->heard());
    if (!unheard.ok()) return unheard.status();
    while (listening_->heard() < localized && !listening_->waits()) {
      auto frame = unheard->Next();
      if (!frame.ok()) return frame.status();
      Listening::Output output;
      Hear(*std::move(frame), output);
      const absl::Status taken = Take(output);
      if (!taken.ok()) return taken;
    }
    return absl::OkStatus();
  }

  void Hear(std::optional<frames::Frame> frame, Listening::Output& output) {
    if (frame) {
      listening_->Hear(*std::move(frame), output);
    } else {
      listening_->SkipHearing();
    }
  }

  absl::Status Take(const Listening::Output& output) {
    for (const Listening::Scan& scan : output.scans) {
      const absl::Status applied = map_->Apply(robot_, scan);
      if (!applied.ok()) return applied;
    }
    return absl::OkStatus();
  }

  const DriveLog& log_;
  const std::string robot_;
  Listening* const listening_;
  TrialMap* const map_;
};

}  // namespace

absl::StatusOr<Trial> TryParameters(const std::vector<TrialDrive>& drives, const Profile& profile,
                                    storage::Store* store, const Session::FrameDecoder& decode,
                                    absl::FunctionRef<bool(double share)> report) {
  auto empty = sound_map::SoundMap::Create(profile.sound_map);
  if (!empty.ok()) return empty.status();
  TrialMap map(*std::move(empty));
  std::int64_t frames = 0;
  for (const TrialDrive& drive : drives) frames += drive.record.frame_count;
  std::int64_t frames_before = 0;
  Trial trial;
  for (const TrialDrive& drive : drives) {
    const auto building = PreparedBuilding::Create(profile, *drive.building);
    if (!building.ok()) return building.status();
    auto listening =
        Listening::Create(profile, /*bands=*/{}, drive.record.calibration, *building,
                          drive.record.initial_pose, storage::Crc32c(drive.record.session));
    if (!listening.ok()) return listening.status();
    const auto log = DriveLog::Open(drive.record, store, decode);
    if (!log.ok()) return log.status();
    const absl::Status run =
        Drive(**log, drive.record.robot, listening->get(), &map).Run([&](std::int64_t offset) {
          return offset % 64 != 0 ||
                 report(static_cast<double>(frames_before + offset) / static_cast<double>(frames));
        });
    if (!run.ok()) return run;
    frames_before += drive.record.frame_count;
    trial.audio_scans += (*listening)->counters().audio_scans;
  }
  trial.sources = map.Sources();
  return trial;
}

std::string ToJson(const Trial& trial) {
  nlohmann::json sources = nlohmann::json::array();
  for (const sound_map::RegisteredSource& registered : trial.sources) {
    const sound_map::SoundSource& source = registered.found;
    const Eigen::Vector3d& position = source.position_in_map_m;
    sources.push_back({{"position_m", {position.x(), position.y(), position.z()}},
                       {"extent_m", source.extent_m},
                       {"probability", source.probability},
                       {"evidence_count", source.evidence_count}});
  }
  return nlohmann::json{{"audio_scans", trial.audio_scans}, {"sources", std::move(sources)}}.dump();
}

}  // namespace soundmap::pipeline
