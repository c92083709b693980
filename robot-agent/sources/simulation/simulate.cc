#include "sources/simulation/simulate.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <span>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "recording/foxglove_messages.h"
#include "recording/writer.h"
#include "sources/simulation/random_streams.h"
#include "sources/simulation/ray_caster.h"
#include "sources/simulation/scanners.h"
#include "sources/simulation/scene.h"
#include "sources/simulation/sound_field.h"
#include "sources/simulation/trajectory.h"
#include "sources/simulation/wheel_odometry.h"

namespace soundmap::simulation {
namespace {

namespace fs = std::filesystem;

constexpr double kPeak = 0.25;  // of full scale: -12 dBFS
constexpr double kFullScale = 32768.0;
constexpr double kGroundTruthRateHz = 10.0;

std::vector<fs::path> SceneFolders() {
  std::vector<fs::path> folders;
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  if (!error) folders.push_back(program.parent_path().parent_path() / "share/soundmap/scenes");
  folders.emplace_back(SOUNDMAP_SCENE_DIR);
  return folders;
}

std::string TruthPath(const std::string& out_path) {
  return fs::path(out_path).replace_extension(".truth.json").string();
}

nlohmann::json ToJson(const Eigen::Vector3d& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

nlohmann::json TruthOf(const Scene& scene, const PlanarPose& start) {
  nlohmann::json truth;
  truth["frame"] = "map";
  truth["room"] = ToJson(scene.room_m);
  truth["start_pose"] = {start.x_m, start.y_m, start.yaw_rad};
  truth["obstacles"] = nlohmann::json::array();
  for (const Box& box : scene.furniture) {
    truth["obstacles"].push_back({ToJson(box.min_m), ToJson(box.max_m)});
  }
  truth["sources"] = nlohmann::json::array();
  for (const auto& source : scene.sources) {
    nlohmann::json entry = {{"position", ToJson(source.position_m)},
                            {"extent_m", source.extent_m},
                            {"kind", source.kind_name},
                            {"level", source.level}};
    if (source.on_s) entry["on_s"] = *source.on_s;
    if (source.off_s) entry["off_s"] = *source.off_s;
    truth["sources"].push_back(entry);
  }
  return truth;
}

// 16 bit samples of a sound field, as many at a time as asked for.
class Digitizer {
 public:
  Digitizer(std::unique_ptr<SoundField> field, int channels)
      : field_(std::move(field)),
        channels_(channels),
        gain_(static_cast<float>(kPeak * kFullScale / std::max(field_->expected_peak(), 1e-9))) {}

  std::span<const std::int16_t> Next(int count) {
    const std::size_t wanted = static_cast<std::size_t>(count) * channels_;
    samples_.erase(samples_.begin(), samples_.begin() + given_);
    while (samples_.size() < wanted) {
      for (float sample : field_->Next()) {
        const long value = std::lround(gain_ * sample);
        clipped_ += value < -32768 || value > 32767;
        samples_.push_back(static_cast<std::int16_t>(std::clamp(value, -32768L, 32767L)));
      }
    }
    given_ = wanted;
    return {samples_.data(), wanted};
  }
  std::int64_t clipped() const { return clipped_; }

 private:
  std::unique_ptr<SoundField> field_;
  int channels_;
  float gain_;
  std::vector<std::int16_t> samples_;
  std::size_t given_ = 0;
  std::int64_t clipped_ = 0;
};

// One topic's messages: number i at i / rate_hz after the start.
struct Stream {
  std::string_view topic;
  double period_s;
  std::function<absl::Status(Stream&, double time_s, std::int64_t stamp_ns)> send;
  std::uint32_t next = 0;

  double next_time_s() const { return next * period_s; }
};

}  // namespace

absl::StatusOr<std::string> FindScene(const std::string& scene) {
  std::error_code error;
  if (fs::is_regular_file(scene, error)) return scene;
  std::vector<std::string> shipped;
  for (const fs::path& folder : SceneFolders()) {
    const bool plain_name = fs::path(scene).filename() == fs::path(scene) && !scene.empty();
    const fs::path file = folder / (scene + ".json");
    if (plain_name && fs::is_regular_file(file, error)) return file.string();
    if (!shipped.empty()) continue;
    for (const auto& entry : fs::directory_iterator(folder, error)) {
      if (entry.path().extension() == ".json") shipped.push_back(entry.path().stem().string());
    }
  }
  std::sort(shipped.begin(), shipped.end());
  return absl::NotFoundError(absl::StrCat("no scene file '", scene,
                                          "' and no shipped scene of that name; there are ",
                                          absl::StrJoin(shipped, ", ")));
}

absl::StatusOr<SimulateResult> Simulate(const std::string& scene_name, const std::string& out_path,
                                        const SimulateOptions& options) {
  const auto scene_path = FindScene(scene_name);
  if (!scene_path.ok()) return scene_path.status();
  const auto scene = LoadScene(*scene_path);
  if (!scene.ok()) return scene.status();
  return Simulate(*scene, out_path, options);
}

absl::StatusOr<SimulateResult> Simulate(const Scene& of_listening, const std::string& out_path,
                                        const SimulateOptions& options) {
  const Scene scene = options.mapping ? MappingDrive(of_listening) : of_listening;
  const auto trajectory = Trajectory::Create(scene.path, scene.path.laps);
  if (!trajectory.ok()) return trajectory.status();
  if (options.seconds && !(*options.seconds > 0.0)) {
    return absl::InvalidArgumentError("the drive's length in seconds must be positive");
  }
  SimulateResult result;
  result.duration_s = trajectory->duration_s();
  if (options.seconds) result.duration_s = std::min(result.duration_s, *options.seconds);
  result.truth_path = TruthPath(out_path);
  if (result.truth_path == out_path) {
    return absl::InvalidArgumentError(absl::StrCat(out_path, ": is the name of the truth file"));
  }

  std::unique_ptr<Digitizer> digitizer;
  const int channels = static_cast<int>(scene.array.microphone_in_array_m.size());
  if (scene.has_audio) {
    auto field = SoundField::Create(scene, *trajectory);
    if (!field.ok()) return field.status();
    digitizer = std::make_unique<Digitizer>(*std::move(field), channels);
  }
  auto opened = recording::Writer::Create(out_path, {});
  if (!opened.ok()) return opened.status();
  recording::Writer& writer = **opened;

  const PlanarPose start = trajectory->At(0.0);
  const RayCaster rays(scene.room_m, scene.furniture);
  auto lidar_engine = MakeEngine(scene.seed, RandomStream::kLidar);
  auto laser_engine = MakeEngine(scene.seed, RandomStream::kLaser);
  WheelOdometry odometry(scene.odometry, start, MakeEngine(scene.seed, RandomStream::kOdometry));

  const auto write = [&](Stream& stream, std::int64_t stamp_ns,
                         const google::protobuf::Message& message) {
    ++result.messages;
    return recording::WriteMessage(writer, stream.topic, stamp_ns, stream.next, message);
  };
  std::vector<Stream> streams;
  streams.push_back({recording::kOdometryTopic, 1.0 / scene.odometry.rate_hz,
                     [&](Stream& stream, double time_s, std::int64_t stamp_ns) {
                       const PlanarPose odom_from_base = odometry.Step(trajectory->At(time_s));
                       return write(
                           stream, stamp_ns,
                           recording::MakeOdometry(stamp_ns, odom_from_base.map_from_base()));
                     }});
  streams.push_back({recording::kGroundTruthTopic, 1.0 / kGroundTruthRateHz,
                     [&](Stream& stream, double time_s, std::int64_t stamp_ns) {
                       return write(stream, stamp_ns,
                                    recording::MakePoseInFrame(
                                        stamp_ns, "map", trajectory->At(time_s).map_from_base()));
                     }});
  streams.push_back({recording::kLaserTopic, 1.0 / scene.laser.rate_hz,
                     [&](Stream& stream, double time_s, std::int64_t stamp_ns) {
                       const double first_rad = FirstBeamAngleRad(scene.laser);
                       return write(stream, stamp_ns,
                                    recording::MakeLaserScan(
                                        stamp_ns, first_rad, -first_rad,
                                        ScanLaser(scene, rays, *trajectory, time_s, laser_engine)));
                     }});
  streams.push_back({recording::kLidarTopic, 1.0 / scene.lidar.rate_hz,
                     [&](Stream& stream, double time_s, std::int64_t stamp_ns) {
                       const LidarScan scan =
                           ScanLidar(scene, rays, *trajectory, time_s, lidar_engine);
                       return write(stream, stamp_ns,
                                    recording::MakePointCloud(stamp_ns, scan.point_in_lidar,
                                                              scan.time_offset_ns));
                     }});
  if (digitizer) {
    const int rate_hz = scene.audio.sample_rate_hz;
    const int chunk = std::max(1, static_cast<int>(std::lround(scene.audio.chunk_s * rate_hz)));
    const double period_s = chunk / (rate_hz * (1.0 + 1e-6 * scene.audio.clock_drift_ppm));
    streams.push_back({recording::kAudioTopic, period_s,
                       [&, rate_hz, chunk](Stream& stream, double, std::int64_t stamp_ns) {
                         return write(stream, stamp_ns,
                                      recording::MakeRawAudio(stamp_ns, rate_hz, channels,
                                                              digitizer->Next(chunk)));
                       }});
  }

  foxglove::FrameTransforms mounts;
  const auto mount = [&](std::string_view parent, std::string_view child,
                         const Eigen::Isometry3d& parent_from_child) {
    *mounts.add_transforms() =
        recording::MakeFrameTransform(scene.start_time_ns, parent, child, parent_from_child);
  };
  mount("base_link", "mic_array", scene.array.base_from_array);
  mount("base_link", "lidar", scene.lidar.base_from_lidar);
  mount("base_link", "laser", scene.laser.base_from_laser);
  for (int m = 0; m < channels; ++m) {
    mount("mic_array", absl::StrCat("mic_", m),
          Eigen::Isometry3d(Eigen::Translation3d(scene.array.microphone_in_array_m[m])));
  }
  ++result.messages;
  absl::Status status =
      recording::WriteMessage(writer, recording::kTransformsTopic, scene.start_time_ns, 0, mounts);

  // In the order of time; at the same time in the order of the streams.
  double reported_s = 0.0;
  while (status.ok()) {
    Stream& stream = *std::min_element(
        streams.begin(), streams.end(),
        [](const Stream& a, const Stream& b) { return a.next_time_s() < b.next_time_s(); });
    const double time_s = stream.next_time_s();
    if (time_s >= result.duration_s) break;
    const std::int64_t stamp_ns = scene.start_time_ns + std::llround(time_s * 1e9);
    status = stream.send(stream, time_s, stamp_ns);
    ++stream.next;
    if (options.progress && time_s >= reported_s) {
      options.progress(time_s / result.duration_s);
      reported_s = time_s + 0.5;
    }
  }
  if (status.ok()) status = writer.Close();
  if (!status.ok()) return status;
  std::ofstream truth(result.truth_path, std::ios::trunc);
  truth << TruthOf(scene, start).dump(1) << "\n";
  truth.close();
  if (!truth) return absl::UnavailableError(absl::StrCat(result.truth_path, ": cannot be written"));
  if (digitizer) result.clipped_samples = digitizer->clipped();
  if (options.progress) options.progress(1.0);
  return result;
}

}  // namespace soundmap::simulation
