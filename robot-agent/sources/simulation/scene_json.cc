#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "sources/simulation/json_fields.h"
#include "sources/simulation/microphone_array.h"
#include "sources/simulation/scene.h"
#include "sources/simulation/trajectory.h"

namespace soundmap::simulation {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180.0;
constexpr double kSabineSecondsPerM = 0.161;
constexpr std::int64_t kLargestFileBytes = 4 << 20;
constexpr int kDeepestNesting = 16;
constexpr Limits kCoordinate{-1000.0, 1000.0};

Eigen::Vector3d Vector(const std::vector<double>& numbers) {
  return {numbers[0], numbers[1], numbers[2]};
}

struct KindName {
  const char* name;
  SoundKind kind;
};
constexpr KindName kKindNames[] = {
    {"fan", SoundKind::kFan},         {"hiss", SoundKind::kHiss},
    {"hum", SoundKind::kHum},         {"speech", SoundKind::kSpeech},
    {"machine", SoundKind::kMachine}, {"motor", SoundKind::kMachine},
    {"white", SoundKind::kWhite},     {"click", SoundKind::kClick},
};

Box ReadBox(const nlohmann::json& element, const std::string& path, JsonErrors& errors) {
  if (!element.is_array() || element.size() != 2) {
    errors.Add(path, "must be two corners [[x, y, z], [x, y, z]]");
    return {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  }
  Box box{Vector(NumbersOf(element[0], path + "[0]", 3, kCoordinate, errors)),
          Vector(NumbersOf(element[1], path + "[1]", 3, kCoordinate, errors))};
  if (!(box.min_m.array() < box.max_m.array()).all()) {
    errors.Add(path, "must have its smaller corner first");
  }
  return box;
}

Eigen::Isometry3d ReadMount(JsonFields& fields, const Eigen::Vector3d& default_position_m) {
  const std::vector<double> standard{default_position_m.x(), default_position_m.y(),
                                     default_position_m.z()};
  const auto position = fields.Numbers("position_m", 3, {-10.0, 10.0}, standard);
  const auto rpy_deg =
      fields.Numbers("rpy_deg", 3, {-360.0, 360.0}, std::vector<double>{0.0, 0.0, 0.0});
  return Eigen::Translation3d(Vector(position)) *
         Eigen::Isometry3d(Eigen::AngleAxisd(rpy_deg[2] * kRadPerDeg, Eigen::Vector3d::UnitZ()) *
                           Eigen::AngleAxisd(rpy_deg[1] * kRadPerDeg, Eigen::Vector3d::UnitY()) *
                           Eigen::AngleAxisd(rpy_deg[0] * kRadPerDeg, Eigen::Vector3d::UnitX()));
}

SourceConfig ReadSource(const nlohmann::json& element, const std::string& path,
                        const Eigen::Vector3d& room_m, const std::string& folder,
                        JsonErrors& errors) {
  JsonFields fields(element, path, errors);
  SourceConfig source;
  source.position_m = Vector(fields.Numbers("position", 3, kCoordinate));
  source.kind_name = fields.String("kind");
  source.extent_m = fields.Number("extent_m", {0.0, 10.0}, source.extent_m);
  source.level = fields.Number("level", {1e-6, 1e6}, source.level);
  source.directivity_db = fields.Number("directivity_db", {-20.0, 40.0}, source.directivity_db);
  if (fields.Has("on_s")) source.on_s = fields.Number("on_s", {0.0, 1e6});
  if (fields.Has("off_s")) source.off_s = fields.Number("off_s", {0.0, 1e6});
  fields.Finish();
  if (source.on_s && source.off_s && *source.off_s <= *source.on_s) {
    errors.Add(path + ".off_s", "must be later than on_s");
  }
  if ((source.position_m.array() < 0.0).any() ||
      (source.position_m.array() > room_m.array()).any()) {
    errors.Add(path + ".position", "must lie in the room");
  }
  for (const auto& [name, kind] : kKindNames) {
    if (source.kind_name == name) {
      source.kind = kind;
      return source;
    }
  }
  if (!source.kind_name.ends_with(".wav")) {
    errors.Add(path + ".kind",
               "must be fan, hiss, hum, speech, machine, motor, white, click or a .wav file");
  }
  source.kind = SoundKind::kWav;
  source.wav_path = (std::filesystem::path(folder) / source.kind_name).string();
  return source;
}

PersonConfig ReadPerson(const nlohmann::json& element, const std::string& path,
                        JsonErrors& errors) {
  JsonFields fields(element, path, errors);
  PersonConfig person;
  person.size_m =
      Vector(fields.Numbers("size_m", 3, {0.05, 5.0}, std::vector<double>{0.5, 0.4, 1.75}));
  const auto points = fields.Elements("way_points", 1000);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto xy =
        NumbersOf(points[i], absl::StrCat(path, ".way_points[", i, "]"), 2, kCoordinate, errors);
    person.way_points_m.emplace_back(xy[0], xy[1]);
  }
  if (points.empty()) errors.Add(path + ".way_points", "must have one point or more");
  person.speed_mps = fields.Number("speed_mps", {0.0, 10.0}, person.speed_mps);
  person.closed = fields.Bool("closed", person.closed);
  fields.Finish();
  return person;
}

// Eyring's formula relates the mean absorption to RT60; pressure reflection is sqrt(1 -
// absorption).
ReverberationConfig ReadReverberation(JsonFields fields, const Eigen::Vector3d& room_m) {
  ReverberationConfig reverberation;
  reverberation.image_order = fields.Integer("image_order", 0, 6, reverberation.image_order);
  Eigen::Matrix<double, 6, 1> area_m2;
  area_m2 << room_m.y() * room_m.z(), room_m.y() * room_m.z(), room_m.x() * room_m.z(),
      room_m.x() * room_m.z(), room_m.x() * room_m.y(), room_m.x() * room_m.y();
  const double eyring_s = kSabineSecondsPerM * room_m.prod() / area_m2.sum();
  reverberation.wall_reflection.setZero();
  if (const auto* absorption = fields.Raw("absorption")) {
    if (fields.Has("rt60_s"))
      fields.errors().Add(fields.PathOf("rt60_s"), "and absorption exclude each other");
    constexpr Limits kShare{0.01, 1.0};
    Eigen::Matrix<double, 6, 1> alpha;
    if (absorption->is_object()) {
      JsonFields walls = fields.Object("absorption");
      int i = 0;
      for (const char* wall : {"x_min", "x_max", "y_min", "y_max", "floor", "ceiling"}) {
        alpha[i++] = walls.Number(wall, kShare);
      }
      walls.Finish();
    } else {
      alpha.setConstant(fields.Number("absorption", kShare));
    }
    const double mean = std::min(alpha.dot(area_m2) / area_m2.sum(), 0.999);
    reverberation.wall_reflection = (1.0 - alpha.array()).max(0.0).sqrt();
    reverberation.rt60_s = -eyring_s / std::log1p(-mean);
  } else {
    reverberation.rt60_s = fields.Number("rt60_s", {0.0, 20.0}, 0.0);
    if (reverberation.rt60_s > 0.0) {
      const double alpha = -std::expm1(-eyring_s / reverberation.rt60_s);
      if (alpha > 0.99) {
        fields.errors().Add(fields.PathOf("rt60_s"),
                            "is shorter than full absorption makes it in this room");
      }
      reverberation.wall_reflection.setConstant(std::sqrt(1.0 - alpha));
    }
  }
  fields.Finish();
  return reverberation;
}

ArrayConfig ReadArray(JsonFields fields) {
  ArrayConfig array;
  array.base_from_array = ReadMount(fields, {0.1, 0.0, 1.2});
  if (fields.Has("microphones_m")) {
    const auto elements = fields.Elements("microphones_m", 64);
    for (std::size_t i = 0; i < elements.size(); ++i) {
      array.microphone_in_array_m.push_back(
          Vector(NumbersOf(elements[i], absl::StrCat(fields.PathOf("microphones_m"), "[", i, "]"),
                           3, {-1.0, 1.0}, fields.errors())));
    }
  } else {
    const auto shape = ArrayShapeFromName(fields.String("shape", "dome"));
    const int count = fields.Integer("count", 1, 64, 16);
    const double radius_m = fields.Number("radius_m", {0.005, 1.0}, 0.15);
    const double height_m = fields.Number("height_m", {-1.0, 1.0}, 0.15);
    if (shape) {
      array.microphone_in_array_m = MakeArray(*shape, count, radius_m, height_m);
    } else {
      fields.errors().Add(fields.PathOf("shape"), "must be ring, two_rings, dome, sphere or cube");
    }
  }
  if (array.microphone_in_array_m.empty()) {
    fields.errors().Add(fields.PathOf("microphones_m"), "must have one microphone or more");
  }
  fields.Finish();
  return array;
}

AudioConfig ReadAudio(JsonFields fields) {
  AudioConfig audio;
  audio.sample_rate_hz = fields.Integer("sample_rate_hz", 8000, 192000, audio.sample_rate_hz);
  audio.chunk_s = fields.Number("chunk_s", {0.01, 1.0}, audio.chunk_s);
  audio.sensor_noise = fields.Number("sensor_noise", {0.0, 1e6}, audio.sensor_noise);
  audio.robot_noise = fields.Number("robot_noise", {0.0, 1e6}, audio.robot_noise);
  audio.clock_drift_ppm =
      fields.Number("clock_drift_ppm", {-1000.0, 1000.0}, audio.clock_drift_ppm);
  audio.obstruction_db = fields.Number("obstruction_db", {0.0, 100.0}, audio.obstruction_db);
  fields.Finish();
  return audio;
}

LidarConfig ReadLidar(JsonFields fields) {
  LidarConfig lidar;
  lidar.base_from_lidar = ReadMount(fields, {0.0, 0.0, 1.45});
  constexpr Limits kElevationDeg{-90.0, 90.0};
  const auto* list = fields.Raw("elevations_deg");
  if (list != nullptr && list->is_array() && !list->empty() && list->size() <= 256) {
    for (double elevation_deg :
         NumbersOf(*list, fields.PathOf("elevations_deg"), static_cast<int>(list->size()),
                   kElevationDeg, fields.errors())) {
      lidar.ring_elevation_rad.push_back(elevation_deg * kRadPerDeg);
    }
  } else if (list != nullptr) {
    fields.errors().Add(fields.PathOf("elevations_deg"), "must be a list of 1 to 256 angles");
  } else {
    const int rings = fields.Integer("rings", 1, 256, 40);
    const auto range_deg =
        fields.Numbers("elevation_deg", 2, kElevationDeg, std::vector<double>{-20.0, 85.0});
    for (int i = 0; i < rings; ++i) {
      const double share = rings == 1 ? 0.5 : static_cast<double>(i) / (rings - 1);
      lidar.ring_elevation_rad.push_back((range_deg[0] + share * (range_deg[1] - range_deg[0])) *
                                         kRadPerDeg);
    }
  }
  const double step_deg = fields.Number("azimuth_step_deg", {0.05, 180.0}, 1.2);
  lidar.azimuth_steps =
      std::max(1, static_cast<int>(std::lround(360.0 / std::max(step_deg, 0.05))));
  lidar.rate_hz = fields.Number("rate_hz", {0.01, 50.0}, lidar.rate_hz);
  lidar.range_noise_m = fields.Number("range_noise_m", {0.0, 10.0}, lidar.range_noise_m);
  lidar.dropout_rate = fields.Number("dropout_rate", {0.0, 1.0}, lidar.dropout_rate);
  lidar.max_range_m = fields.Number("max_range_m", {0.1, 1000.0}, lidar.max_range_m);
  lidar.swept = fields.Bool("swept", lidar.swept);
  fields.Finish();
  return lidar;
}

LaserConfig ReadLaser(JsonFields fields) {
  LaserConfig laser;
  laser.base_from_laser = ReadMount(fields, {0.2, 0.0, 0.3});
  laser.beams = fields.Integer("beams", 2, 20000, laser.beams);
  laser.field_of_view_rad = fields.Number("field_of_view_deg", {1.0, 360.0}, 270.0) * kRadPerDeg;
  laser.rate_hz = fields.Number("rate_hz", {0.01, 200.0}, laser.rate_hz);
  laser.range_noise_m = fields.Number("range_noise_m", {0.0, 10.0}, laser.range_noise_m);
  laser.bad_beam_rate = fields.Number("bad_beam_rate", {0.0, 1.0}, laser.bad_beam_rate);
  laser.dropout_rate = fields.Number("dropout_rate", {0.0, 1.0}, laser.dropout_rate);
  laser.max_range_m = fields.Number("max_range_m", {0.1, 1000.0}, laser.max_range_m);
  fields.Finish();
  return laser;
}

OdometryConfig ReadOdometry(JsonFields fields) {
  OdometryConfig odometry;
  odometry.rate_hz = fields.Number("rate_hz", {0.1, 1000.0}, odometry.rate_hz);
  odometry.translation_scale =
      fields.Number("translation_scale", {0.1, 10.0}, odometry.translation_scale);
  odometry.yaw_scale = fields.Number("yaw_scale", {0.1, 10.0}, odometry.yaw_scale);
  odometry.yaw_drift_rad_per_m =
      fields.Number("yaw_drift_rad_per_m", {-1.0, 1.0}, odometry.yaw_drift_rad_per_m);
  odometry.translation_noise_m_per_sqrt_m = fields.Number(
      "translation_noise_m_per_sqrt_m", {0.0, 1.0}, odometry.translation_noise_m_per_sqrt_m);
  odometry.yaw_noise_rad_per_sqrt_m =
      fields.Number("yaw_noise_rad_per_sqrt_m", {0.0, 1.0}, odometry.yaw_noise_rad_per_sqrt_m);
  fields.Finish();
  return odometry;
}

PathConfig ReadPath(JsonFields fields) {
  PathConfig path;
  const double speed_mps = fields.Number("speed_mps", {0.02, 10.0}, 0.6);
  const auto points = fields.Elements("way_points", 10000);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const bool own_speed = points[i].is_array() && points[i].size() == 3;
    const auto numbers =
        NumbersOf(points[i], absl::StrCat(fields.PathOf("way_points"), "[", i, "]"),
                  own_speed ? 3 : 2, kCoordinate, fields.errors());
    path.way_points_m.emplace_back(numbers[0], numbers[1]);
    path.speed_mps.push_back(own_speed ? numbers[2] : speed_mps);
    if (!(path.speed_mps.back() >= 0.02 && path.speed_mps.back() <= 10.0)) {
      fields.errors().Add(absl::StrCat(fields.PathOf("way_points"), "[", i, "]"),
                          "must have a speed from 0.02 to 10");
    }
  }
  if (points.empty())
    fields.errors().Add(fields.PathOf("way_points"), "must have one point or more");
  path.closed = fields.Bool("closed", path.closed);
  path.laps = fields.Number("laps", {0.01, 1000.0}, path.laps);
  path.mapping_laps = fields.Number("mapping_laps", {0.01, 1000.0}, path.laps);
  if (!path.closed && path.laps != 1.0) {
    fields.errors().Add(fields.PathOf("laps"), "must be 1 on a path that is not closed");
  }
  path.turn_smoothing_m = fields.Number("turn_smoothing_m", {0.0, 20.0}, path.turn_smoothing_m);
  path.acceleration_mps2 = fields.Number("acceleration_mps2", {0.01, 20.0}, path.acceleration_mps2);
  path.max_yaw_rate_radps =
      fields.Number("max_yaw_rate_dps", {1.0, 720.0}, path.max_yaw_rate_radps / kRadPerDeg) *
      kRadPerDeg;
  path.standing_yaw_rad = fields.Number("standing_yaw_deg", {-360.0, 360.0}, 0.0) * kRadPerDeg;
  path.standing_s = fields.Number("standing_s", {0.0, 86400.0}, 0.0);
  fields.Finish();
  return path;
}

// The robot must have room where it drives: up to its highest sensor no furniture, and walls around
// it.
void CheckPath(const Scene& scene, JsonErrors& errors) {
  for (const double laps : {scene.path.laps, scene.path.mapping_laps}) {
    const auto trajectory = Trajectory::Create(scene.path, laps);
    if (!trajectory.ok()) {
      errors.Add("path",
                 absl::StrCat("cannot be driven: ", std::string(trajectory.status().message())));
      return;
    }
  }
  const auto trajectory = Trajectory::Create(scene.path, std::min(1.0, scene.path.laps));
  if (!trajectory.ok()) return;
  std::vector<std::pair<const char*, Eigen::Vector3d>> sensors = {
      {"lidar.position_m", scene.lidar.base_from_lidar.translation()},
      {"laser.position_m", scene.laser.base_from_laser.translation()}};
  for (const auto& microphone_in_array_m : scene.array.microphone_in_array_m) {
    sensors.emplace_back("array.position_m", scene.array.base_from_array * microphone_in_array_m);
  }
  double height_m = 0.0;
  for (const auto& [field, position] : sensors) height_m = std::max(height_m, position.z());
  const double step_s = std::max(0.05, trajectory->duration_s() / 20000);
  const int steps = static_cast<int>(trajectory->duration_s() / step_s);
  for (int i = 0; i <= steps; ++i) {
    const auto pose = trajectory->At(i * step_s);
    const Eigen::Isometry3d map_from_base = pose.map_from_base();
    const auto place = absl::StrFormat("near (%.2f, %.2f)", pose.x_m, pose.y_m);
    for (const auto& [field, position] : sensors) {
      const Eigen::Vector3d point = map_from_base * position;
      if ((point.array() <= 0.0).any() || (point.array() >= scene.room_m.array()).any()) {
        errors.Add(field, absl::StrCat("leaves the room on the path ", place));
        return;
      }
    }
    for (std::size_t i = 0; i < scene.furniture.size(); ++i) {
      const Box& box = scene.furniture[i];
      if (box.min_m.z() < height_m && pose.x_m > box.min_m.x() && pose.x_m < box.max_m.x() &&
          pose.y_m > box.min_m.y() && pose.y_m < box.max_m.y()) {
        errors.Add("path", absl::StrCat("runs through furniture[", i, "] ", place));
        return;
      }
    }
  }
}

}  // namespace

absl::StatusOr<Scene> ParseScene(const std::string& text, const std::string& name,
                                 const std::string& folder) {
  bool too_deep = false;
  nlohmann::json document;
  try {
    document =
        nlohmann::json::parse(text, [&](int depth, nlohmann::json::parse_event_t, nlohmann::json&) {
          too_deep = too_deep || depth > kDeepestNesting;
          return !too_deep;
        });
  } catch (const nlohmann::json::exception& error) {
    return absl::InvalidArgumentError(absl::StrCat(name, ": is not JSON: ", error.what()));
  }
  if (too_deep) return absl::InvalidArgumentError(absl::StrCat(name, ": nests too deeply"));

  JsonErrors errors(name);
  JsonFields fields(document, "", errors);
  Scene scene;
  scene.room_m = Vector(fields.Numbers("room_m", 3, {0.5, 500.0}));
  if (!errors.ok()) return errors.status();
  scene.seed = static_cast<std::uint64_t>(fields.Number("seed", {0.0, 9e15}, 1.0));
  scene.start_time_ns = static_cast<std::int64_t>(
      std::llround(fields.Number("start_time_s", {4000.0, 9e9}, 1.7e9) * 1e9));
  scene.speed_of_sound_mps =
      fields.Number("speed_of_sound_mps", {100.0, 2000.0}, scene.speed_of_sound_mps);
  scene.reverberation = ReadReverberation(fields.Object("reverberation"), scene.room_m);

  const auto furniture = fields.Elements("furniture", 1000);
  for (std::size_t i = 0; i < furniture.size(); ++i) {
    scene.furniture.push_back(ReadBox(furniture[i], absl::StrCat("furniture[", i, "]"), errors));
  }
  const auto sources = fields.Elements("sources", 64);
  for (std::size_t i = 0; i < sources.size(); ++i) {
    scene.sources.push_back(
        ReadSource(sources[i], absl::StrCat("sources[", i, "]"), scene.room_m, folder, errors));
  }
  const auto people = fields.Elements("people", 64);
  for (std::size_t i = 0; i < people.size(); ++i) {
    scene.people.push_back(ReadPerson(people[i], absl::StrCat("people[", i, "]"), errors));
  }
  scene.array = ReadArray(fields.Object("array"));
  const auto* audio = fields.Raw("audio");
  if (audio != nullptr && audio->is_boolean()) {
    scene.has_audio = audio->get<bool>();
  } else {
    scene.audio = ReadAudio(fields.Object("audio"));
  }
  scene.lidar = ReadLidar(fields.Object("lidar"));
  scene.laser = ReadLaser(fields.Object("laser"));
  scene.odometry = ReadOdometry(fields.Object("odometry"));
  scene.path = ReadPath(fields.Object("path"));
  fields.Finish();
  if (errors.ok()) CheckPath(scene, errors);
  if (!errors.ok()) return errors.status();
  return scene;
}

absl::StatusOr<Scene> LoadScene(const std::string& path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  std::ifstream file(path, std::ios::binary);
  if (error || !file) return absl::NotFoundError(absl::StrCat(path, ": cannot be read as a scene"));
  if (size > static_cast<std::uintmax_t>(kLargestFileBytes)) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": is too large for a scene"));
  }
  std::stringstream text;
  text << file.rdbuf();
  return ParseScene(text.str(), path, std::filesystem::path(path).parent_path().string());
}

}  // namespace soundmap::simulation
