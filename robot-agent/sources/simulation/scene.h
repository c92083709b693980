#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

// A scene: what stands in a room, what sounds there, and the robot that drives through it. Frame
// `map`: one corner of the room is the origin, the floor is z = 0. Times count from the start of
// the drive.
namespace soundmap::simulation {

struct Box {
  Eigen::Vector3d min_m, max_m;
};

enum class SoundKind { kFan, kHiss, kHum, kSpeech, kMachine, kWhite, kClick, kWav };

struct SourceConfig {
  Eigen::Vector3d position_m;
  SoundKind kind = SoundKind::kFan;
  std::string kind_name;        // as in the file
  std::string wav_path;         // kWav: absolute or relative to the working directory
  double extent_m = 0.0;        // edge of the square that emits
  double level = 1.0;           // rms amplitude at 1 m; kClick: the click's amplitude
  double directivity_db = 0.0;  // reflections and tail are as much weaker than those of a source
                                // that sounds alike on all sides
  std::optional<double> on_s, off_s;
};

// A box that walks along a closed or open line (there and back) at constant speed.
struct PersonConfig {
  Eigen::Vector3d size_m{0.5, 0.4, 1.75};
  std::vector<Eigen::Vector2d> way_points_m;
  double speed_mps = 1.0;
  bool closed = false;
};

struct ReverberationConfig {
  double rt60_s = 0.0;  // 0: free field
  Eigen::Matrix<double, 6, 1>
      wall_reflection;  // pressure, of x = 0, x = max, y = 0, y = max, floor, ceiling
  int image_order = 2;
};

struct ArrayConfig {
  Eigen::Isometry3d base_from_array = Eigen::Isometry3d::Identity();
  std::vector<Eigen::Vector3d> microphone_in_array_m;
};

struct AudioConfig {
  int sample_rate_hz = 16000;
  double chunk_s = 0.05;
  double sensor_noise = 0.01;  // rms amplitude of each microphone, in the unit of `level`
  double robot_noise = 0.0;    // rms amplitude at 1 m of the robot's own drive, which the room
                               // reflects
  double clock_drift_ppm =
      0.0;  // of the audio device: it takes (1 + 1e-6 ppm) * sample_rate_hz samples a second
  double obstruction_db = 12.0;  // loss of a direct path through furniture or a person
};

struct LidarConfig {
  Eigen::Isometry3d base_from_lidar = Eigen::Isometry3d::Identity();
  std::vector<double> ring_elevation_rad;
  int azimuth_steps = 300;
  double rate_hz = 2.0;
  double range_noise_m = 0.015;
  double dropout_rate = 0.02;
  double max_range_m = 30.0;
  bool swept = false;  // points are taken at their own times, one turn a scan
};

struct LaserConfig {
  Eigen::Isometry3d base_from_laser = Eigen::Isometry3d::Identity();
  int beams = 541;
  double field_of_view_rad = 0.0;
  double rate_hz = 10.0;
  double range_noise_m = 0.01;
  double bad_beam_rate = 0.01;  // such a beam reads anything
  double dropout_rate = 0.0;    // such a beam reads `inf`
  double max_range_m = 30.0;
};

struct OdometryConfig {
  double rate_hz = 20.0;
  double translation_scale = 1.01;
  double yaw_scale = 1.0;
  double yaw_drift_rad_per_m = 0.0095;
  double translation_noise_m_per_sqrt_m = 0.002;
  double yaw_noise_rad_per_sqrt_m = 0.0015;
};

struct PathConfig {
  std::vector<Eigen::Vector2d> way_points_m;
  std::vector<double> speed_mps;  // one a way point, from there on
  bool closed = true;
  double laps = 1.0;
  double mapping_laps = 1.0;
  double turn_smoothing_m = 0.8;  // length over which corners are rounded
  double acceleration_mps2 = 0.5;
  double max_yaw_rate_radps = 0.8;
  double standing_yaw_rad = 0.0;  // one way point: the robot stands there
  double standing_s = 0.0;
};

struct Scene {
  Eigen::Vector3d room_m;
  std::vector<Box> furniture;
  std::vector<SourceConfig> sources;
  std::vector<PersonConfig> people;
  ReverberationConfig reverberation;
  ArrayConfig array;
  AudioConfig audio;
  bool has_audio = true;
  LidarConfig lidar;
  LaserConfig laser;
  OdometryConfig odometry;
  PathConfig path;
  std::int64_t start_time_ns = 0;
  std::uint64_t seed = 1;
  double speed_of_sound_mps = 343.0;
};

// Reads and checks a scene file. Every error is one sentence that names the file and the field.
absl::StatusOr<Scene> LoadScene(const std::string& path);

// The same from text; `name` stands for the file in errors, relative paths count from `folder`.
absl::StatusOr<Scene> ParseScene(const std::string& text, const std::string& name,
                                 const std::string& folder);

// The drive that maps the scene's building: same path, no audio, another seed, an hour earlier.
Scene MappingDrive(Scene scene);

// Where a person's feet are.
Eigen::Vector2d PersonPosition(const PersonConfig& person, double time_s);
std::vector<Box> PeopleAt(const std::vector<PersonConfig>& people, double time_s);

}  // namespace soundmap::simulation
