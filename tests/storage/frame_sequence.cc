#include "storage/frame_sequence.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numbers>
#include <set>
#include <system_error>

namespace soundmap::storage {
namespace {

constexpr std::array<const char*, 3> kTopics = {"/audio", "/scan", "/odom"};
constexpr std::array<const char*, 3> kSchemas = {"foxglove.RawAudio", "foxglove.LaserScan",
                                                 "foxglove.Odometry"};

std::uint64_t Mixed(std::uint64_t value) {
  value = (value + 0x9e3779b97f4a7c15u) * 0xbf58476d1ce4e5b9u;
  return value ^ (value >> 29);
}

std::string EmptyFolderUnder(const std::filesystem::path& parent, const std::string& name) {
  struct Folders {
    std::set<std::filesystem::path> paths;
    ~Folders() {
      std::error_code ignored;
      for (const auto& path : paths) std::filesystem::remove_all(path, ignored);
    }
  };
  static Folders folders;
  const std::filesystem::path path =
      parent / ("soundmap_storage_" + std::to_string(::getpid()) + "_" + name);
  folders.paths.insert(path);
  std::filesystem::remove_all(path);
  std::filesystem::create_directories(path);
  return path.string();
}

}  // namespace

recording::Message FrameAt(std::int64_t offset) {
  std::mt19937_64 random(Mixed(static_cast<std::uint64_t>(offset)));
  recording::Message frame;
  const std::size_t kind = random() % kTopics.size();
  frame.topic = kTopics[kind];
  frame.schema = kSchemas[kind];
  frame.log_time_ns = 1'700'000'000'000'000'000 + 1'000'000 * offset;
  frame.data.resize(random() % 300);
  for (char& byte : frame.data) byte = static_cast<char>(random());
  return frame;
}

JournalEntry EntryAt(std::int64_t offset) {
  std::mt19937_64 random(Mixed(static_cast<std::uint64_t>(offset) + 1));
  JournalEntry entry;
  entry.offset = offset;
  entry.summary = "scan at " + std::to_string(offset);
  entry.evidence.stamp_ns = 1'700'000'000'000'000'000 + static_cast<std::int64_t>(random() % 1000);
  entry.evidence.end_points = RoomEndPoints(50, &random);
  return entry;
}

StateSnapshot StateAt(std::int64_t offset) {
  return {offset, "state after " + std::to_string(offset)};
}

std::vector<sound_map::EndPoint> RoomEndPoints(int directions, std::mt19937_64* random) {
  constexpr std::array<double, 3> kHalfSize = {120.0, 80.0, 30.0};  // voxels
  std::array<double, 3> place;
  for (int axis = 0; axis < 3; ++axis) {
    place[axis] = kHalfSize[axis] * std::uniform_real_distribution<double>(-0.7, 0.7)(*random);
  }
  std::normal_distribution<double> range_noise(0.0, 0.3);
  std::vector<sound_map::EndPoint> points;
  const double golden_angle_rad = std::numbers::pi * (3.0 - std::sqrt(5.0));
  for (int i = 0; i < directions; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / directions;
    const double radius = std::sqrt(1.0 - z * z);
    const std::array<double, 3> direction = {radius * std::cos(golden_angle_rad * i),
                                             radius * std::sin(golden_angle_rad * i), z};
    double range = 1e9;
    for (int axis = 0; axis < 3; ++axis) {
      const double wall = std::copysign(kHalfSize[axis], direction[axis]);
      range = std::min(range, (wall - place[axis]) / direction[axis]);
    }
    range += range_noise(*random);
    const auto key = [&](int axis) {
      return static_cast<std::uint16_t>(32768.0 + place[axis] + range * direction[axis]);
    };
    const double along = direction[0] * 0.6 + direction[2] * 0.8;
    points.push_back({{key(0), key(1), key(2)},
                      along > 0.998   ? 0.9f
                      : along > 0.985 ? 0.5f
                                      : 0.4f});
  }
  return points;
}

std::string EmptyFolder(const std::string& name) {
  const char* const temporary = std::getenv("TEST_TMPDIR");
  return EmptyFolderUnder(temporary != nullptr ? std::filesystem::path(temporary)
                                               : std::filesystem::temp_directory_path(),
                          name);
}

std::string EmptyMemoryFolder(const std::string& name) {
  const std::filesystem::path memory = "/dev/shm";
  return ::access(memory.c_str(), W_OK) == 0 ? EmptyFolderUnder(memory, name) : EmptyFolder(name);
}

std::string ReadWholeFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

void WriteWholeFile(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
}

std::vector<std::string> FilesUnder(const std::string& folder, const std::string& suffix) {
  std::vector<std::string> paths;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    const std::string path = entry.path().string();
    if (entry.is_regular_file() && path.ends_with(suffix)) paths.push_back(path);
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

}  // namespace soundmap::storage
