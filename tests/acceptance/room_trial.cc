#include "tests/acceptance/room_trial.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <deque>
#include <filesystem>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "api/decode_frame.h"
#include "building/stored_building.h"
#include "cli/visibility.h"
#include "mapping/mapper.h"
#include "pipeline/listening.h"
#include "recording/drive.h"
#include "recording/reader.h"
#include "sound_map/sound_map.h"
#include "sound_map/source_register.h"
#include "sources/simulation/random_scene.h"
#include "sources/simulation/simulate.h"
#include "sources/simulation/trajectory.h"

namespace soundmap::acceptance {
namespace {

namespace fs = std::filesystem;

struct Drive {
  frames::Calibration calibration;
  std::vector<frames::Frame> frames;
};

absl::StatusOr<Drive> ReadDrive(const std::string& path) {
  const auto survey = recording::SurveyDrive(path);
  if (!survey.ok()) return survey.status();
  const auto model = recording::MakeRobotModel(survey->transforms, survey->audio_channels);
  if (!model.ok()) return model.status();
  Drive drive;
  const auto identity = Eigen::Isometry3d::Identity();
  drive.calibration.base_from_array = model->base_from_array.value_or(identity);
  drive.calibration.base_from_lidar = model->base_from_lidar.value_or(identity);
  drive.calibration.base_from_laser = model->base_from_laser.value_or(identity);
  drive.calibration.mic_in_array_m = model->mic_in_array_m;
  drive.calibration.audio_sample_rate_hz = survey->audio_sample_rate_hz;
  auto reader = recording::Reader::Open(path);
  if (!reader.ok()) return reader.status();
  for (;;) {
    const auto message = (*reader)->Next();
    if (!message.ok()) return message.status();
    if (!*message) return drive;
    const std::string& topic = (*message)->topic;
    if (topic != recording::kAudioTopic && topic != recording::kLidarTopic &&
        topic != recording::kLaserTopic && topic != recording::kOdometryTopic) {
      continue;
    }
    auto frame = api::DecodeFrame((*message)->schema, (*message)->data, drive.calibration);
    if (!frame.ok()) return frame.status();
    drive.frames.push_back(*std::move(frame));
  }
}

absl::StatusOr<building::Building> MapBuilding(const std::string& mapping_path,
                                               const geometry::Pose2& start) {
  const std::string stored_path = fs::path(mapping_path).replace_extension(".building").string();
  if (std::ifstream stored(stored_path, std::ios::binary); stored) {
    std::stringstream bytes;
    bytes << stored.rdbuf();
    return building::ParseBuilding(bytes.str());
  }
  const auto drive = ReadDrive(mapping_path);
  if (!drive.ok()) return drive.status();
  auto mapper = mapping::Mapper::Create({}, drive->calibration, start);
  if (!mapper.ok()) return mapper.status();
  for (const frames::Frame& frame : drive->frames) mapper->Add(frame).IgnoreError();
  const auto result = mapper->Finish();
  if (!result.ok()) return result.status();
  std::ofstream(stored_path, std::ios::binary) << building::SerializeBuilding(result->building);
  return result->building;
}

SoundSource ToReported(const sound_map::SoundSource& source) {
  const Eigen::Vector3d& p = source.position_in_map_m;
  SoundSource reported;
  reported.position_in_map_m = {p.x(), p.y(), p.z()};
  reported.probability = source.probability;
  return reported;
}

// Drives the path to and fro, if once is less than so long.
void DriveFor(double seconds, simulation::PathConfig& path) {
  const auto once = simulation::Trajectory::Create(path, path.laps);
  const std::size_t count = path.way_points_m.size();
  if (path.closed || count < 2 || !once.ok() || once->duration_s() >= seconds) return;
  path.speed_mps[count - 1] = path.speed_mps[count - 2];
  for (std::size_t i = count - 2; i > 0; --i) {
    path.way_points_m.push_back(path.way_points_m[i]);
    path.speed_mps.push_back(path.speed_mps[i - 1]);
  }
  path.closed = true;
  path.laps = seconds / once->duration_s();
}

}  // namespace

bool Trial::planar() const {
  Eigen::MatrixXd mics(3, calibration.mic_in_array_m.size());
  for (Eigen::Index i = 0; i < mics.cols(); ++i) mics.col(i) = calibration.mic_in_array_m[i];
  mics.colwise() -= mics.rowwise().mean().eval();
  return Eigen::JacobiSVD<Eigen::MatrixXd>(mics).singularValues()[2] < 1e-3;
}

absl::StatusOr<Trial> ReadTrial(const std::string& drive_path, const std::string& mapping_path) {
  Trial trial;
  trial.name = fs::path(drive_path).stem().string();
  auto drive = ReadDrive(drive_path);
  if (!drive.ok()) return drive.status();
  trial.calibration = drive->calibration;
  trial.frames = std::move(drive->frames);
  auto truth = cli::ReadDriveTruth(drive_path);
  if (!truth.ok()) return truth.status();
  trial.truth = *std::move(truth);
  auto scene = cli::ReadTruthFile(fs::path(drive_path).replace_extension(".truth.json").string());
  if (!scene.ok()) return scene.status();
  trial.scene = *std::move(scene);
  const auto start_of = [](const cli::DriveTruth& truth) {
    const Pose2& pose = truth.map_from_base.front().map_from_base;
    return geometry::Pose2{pose.x_m, pose.y_m, pose.yaw_rad};
  };
  trial.start = start_of(trial.truth);
  const auto mapping_truth = cli::ReadDriveTruth(mapping_path);
  if (!mapping_truth.ok()) return mapping_truth.status();
  auto building = MapBuilding(mapping_path, start_of(*mapping_truth));
  if (!building.ok()) return building.status();
  trial.building = std::make_shared<const building::Building>(*std::move(building));
  return trial;
}

absl::StatusOr<Trial> RandomTrial(std::uint64_t seed, const RoomVariant& variant,
                                  const std::string& folder) {
  auto text = simulation::RandomScene(seed);
  if (!text.ok()) return text.status();
  nlohmann::json json = nlohmann::json::parse(*text);
  std::string name = absl::StrCat("room", seed);
  if (variant.silent) {
    absl::StrAppend(&name, "_silent");
    json["sources"] = nlohmann::json::array();
    json["audio"]["robot_noise"] = 0.02;
    json.erase("people");
  }
  if (variant.seconds) absl::StrAppend(&name, "_", std::lround(*variant.seconds), "s");
  const fs::path drive = fs::path(folder) / (name + ".mcap");
  const fs::path mapping = fs::path(folder) / absl::StrCat("room", seed, "_mapping.mcap");
  const auto scene = simulation::ParseScene(json.dump(), name, folder);
  if (!scene.ok()) return scene.status();
  fs::create_directories(folder);
  for (const auto& [path, is_mapping] : {std::pair(mapping, true), std::pair(drive, false)}) {
    if (fs::exists(path)) continue;
    simulation::SimulateOptions options;
    options.mapping = is_mapping;
    if (!is_mapping) options.seconds = variant.seconds;
    simulation::Scene played = *scene;
    if (is_mapping) played.people.clear();
    if (!is_mapping && variant.seconds) DriveFor(*variant.seconds, played.path);
    // A drive that was not finished leaves no file of the name.
    const fs::path partial = fs::path(folder) / ("partial_" + path.filename().string());
    const auto made = simulation::Simulate(played, partial.string(), options);
    if (!made.ok()) return made.status();
    fs::rename(fs::path(partial).replace_extension(".truth.json"),
               fs::path(path).replace_extension(".truth.json"));
    fs::rename(partial, path);
  }
  auto trial = ReadTrial(drive.string(), mapping.string());
  if (trial.ok()) trial->name = name;
  return trial;
}

void Inject(Fault fault, Trial& trial) {
  std::mt19937 engine(7);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const int channels = static_cast<int>(trial.calibration.mic_in_array_m.size());
  std::vector<double> gain(channels, 1.0);
  if (fault == Fault::kDeadMicrophone) gain[channels / 2] = 0.0;
  if (fault == Fault::kInvertedMicrophone) gain[channels / 2] = -1.0;
  if (fault == Fault::kGains) {
    for (double& g : gain) g = std::pow(10.0, 1.5 * uniform(engine) / 20.0);
  }
  if (fault == Fault::kArrayOffset) {
    const Eigen::Vector3d offset(uniform(engine), uniform(engine), uniform(engine));
    trial.calibration.base_from_array.pretranslate(0.02 * offset.normalized());
  }
  std::vector<frames::Frame> frames;
  for (frames::Frame& frame : trial.frames) {
    if (auto* audio = std::get_if<frames::AudioBlock>(&frame)) {
      if (fault == Fault::kLostAudio && uniform(engine) < -0.9) continue;
      for (std::size_t i = 0; i < audio->samples.size(); ++i) {
        audio->samples[i] = static_cast<std::int16_t>(
            std::clamp(std::lround(gain[i % channels] * audio->samples[i]), -32768L, 32767L));
      }
    }
    frames.push_back(std::move(frame));
  }
  trial.frames = std::move(frames);
}

int TrialResult::in_view() const {
  return static_cast<int>(std::count_if(sources.begin(), sources.end(),
                                        [](const SourceResult& s) { return s.in_view; }));
}

int TrialResult::detected() const {
  return static_cast<int>(std::count_if(sources.begin(), sources.end(), [](const SourceResult& s) {
    return s.in_view && s.error_m.has_value();
  }));
}

int TrialResult::doubles() const {
  int count = 0;
  for (const SourceResult& source : sources) count += source.in_view ? source.doubles : 0;
  return count;
}

absl::StatusOr<TrialResult> Run(const Trial& trial, const pipeline::Profile& profile) {
  const auto building = pipeline::PreparedBuilding::Create(profile, *trial.building);
  if (!building.ok()) return building.status();
  auto listening = pipeline::Listening::Create(profile, /*bands=*/{}, trial.calibration, *building,
                                               trial.start, /*seed=*/1);
  if (!listening.ok()) return listening.status();
  auto map = sound_map::SoundMap::Create(profile.sound_map);
  if (!map.ok()) return map.status();

  TrialResult result;
  sound_map::SourceRegister sources(profile.sound_map);
  sound_map::SourceFinder finder(profile.sound_map.sources);
  std::int64_t peaks = 0;
  std::vector<PoseEstimate> path;
  const auto take = [&](pipeline::Listening::Output& output) -> absl::Status {
    for (const auto& scan : output.scans) {
      peaks += static_cast<std::int64_t>(scan.audio.peaks.size());
      ++result.scans;
      const absl::Status applied = (*map)->Apply(scan.evidence);
      if (!applied.ok()) return applied;
      const geometry::Pose2& pose = scan.pose.map_from_base;
      sources.Observe({"robot",
                       {pose.x_m, pose.y_m},
                       &scan.evidence,
                       &scan.heard,
                       scan.array_plane,
                       scan.full_scale_spl_db,
                       scan.array_in_map_m});
      if (sources.due()) sources.Update(finder.Find((*map)->Present()));
    }
    for (const auto& pose : output.path) {
      const geometry::Pose2& p = pose.map_from_base;
      path.push_back({.time_ns = pose.stamp_ns, .map_from_base = {p.x_m, p.y_m, p.yaw_rad}});
    }
    output = {};
    return absl::OkStatus();
  };
  pipeline::Listening::Output output;
  std::deque<const frames::Frame*> to_hear;
  for (const frames::Frame& frame : trial.frames) {
    (*listening)->Localize(frame, output);
    to_hear.push_back(&frame);
    while (!to_hear.empty() && !(*listening)->waits()) {
      (*listening)->Hear(*to_hear.front(), output);
      to_hear.pop_front();
    }
    if (const absl::Status taken = take(output); !taken.ok()) return taken;
  }
  (*listening)->Finish(output);
  if (const absl::Status taken = take(output); !taken.ok()) return taken;
  result.warnings = (*listening)->Warnings();
  result.peaks_per_scan =
      static_cast<double>(peaks) / static_cast<double>(std::max<std::int64_t>(1, result.scans));
  std::stable_sort(path.begin(), path.end(),
                   [](const auto& a, const auto& b) { return a.time_ns < b.time_ns; });
  if (const auto pose = cli::ScoreAgainstDrive(path, trial.truth.map_from_base); pose.ok()) {
    result.pose_error_m = pose->error_mean_m;
  }

  if (sources.pending()) sources.Update(finder.Find((*map)->Present()));
  for (const sound_map::RegisteredSource& source : sources.Sources()) {
    if (source.state != sound_map::SourceState::kGone) result.found.push_back(source);
  }
  std::vector<SoundSource> reported;
  for (const auto& source : result.found) reported.push_back(ToReported(source.found));
  const std::vector<cli::TrueSource>& truth = trial.scene.sources;
  const auto in_view = cli::SourcesInView(
      trial.scene, cli::ArrayPath(trial.truth.map_from_base, *trial.truth.array_in_base_m),
      trial.truth.start_ns, profile.ray_casting.max_range_m);
  result.false_count = cli::ScoreSources(reported, truth, in_view).false_count;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    std::vector<bool> this_one(truth.size(), false);
    this_one[i] = true;
    const cli::SourceScore score = cli::ScoreSources(reported, truth, this_one);
    result.sources.push_back(
        {truth[i].kind, truth[i].level, in_view[i], score.error_mean_m, score.double_count});
  }
  result.candidates = cli::JudgeCandidates(reported, truth, in_view);
  return result;
}

void Summary::Add(const TrialResult& result) {
  in_view += result.in_view();
  detected += result.detected();
  false_count += result.false_count;
  doubles += result.doubles();
  for (const SourceResult& source : result.sources) {
    if (source.in_view && source.error_m) errors_m.push_back(*source.error_m);
  }
  std::sort(errors_m.begin(), errors_m.end());
  candidates.insert(candidates.end(), result.candidates.begin(), result.candidates.end());
}

double Summary::recall() const {
  return in_view == 0 ? 1.0 : static_cast<double>(detected) / in_view;
}

double Summary::precision() const {
  const int all = detected + false_count + doubles;
  return all == 0 ? 1.0 : static_cast<double>(detected) / all;
}

double Summary::ErrorQuantile(double share) const {
  if (errors_m.empty()) return 0.0;
  const double rank = share * static_cast<double>(errors_m.size() - 1);
  const auto below = static_cast<std::size_t>(rank);
  if (below + 1 == errors_m.size()) return errors_m[below];
  return errors_m[below] +
         (rank - static_cast<double>(below)) * (errors_m[below + 1] - errors_m[below]);
}

}  // namespace soundmap::acceptance
