#include "sources/simulation/random_scene.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <random>

#include "absl/strings/str_cat.h"
#include "sources/simulation/free_floor.h"
#include "sources/simulation/microphone_array.h"
#include "sources/simulation/scene.h"
#include "sources/simulation/trajectory.h"

namespace soundmap::simulation {
namespace {

using nlohmann::json;

constexpr double kPi = std::numbers::pi;
constexpr double kRobotRadius_m = 0.55;
constexpr double kBetweenSources_m = 1.2;
constexpr double kLongestPath_m = 36.0;
constexpr double kShortestPath_m = 18.0;
constexpr double kSharpestTurn_rad = 1.9;
constexpr double kRobotFromPerson_m = 0.9;
constexpr int kTrials = 200;  // of anything that may turn out not to fit

json ToJson(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

// One draw of a scene; some draws cannot be driven through.
class Draw {
 public:
  Draw(std::uint64_t seed, std::uint32_t trial) : seed_(seed) {
    std::seed_seq sequence{static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32),
                           trial, 0x726f6f6du};
    engine_.seed(sequence);
  }

  // None: this draw does not work out.
  std::optional<json> Make();

 private:
  double Uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine_);
  }
  int Integer(int low, int high) { return std::uniform_int_distribution<int>(low, high)(engine_); }
  bool Chance(double share) { return Uniform(0.0, 1.0) < share; }
  double LogUniform(double low, double high) {
    return std::exp(Uniform(std::log(low), std::log(high)));
  }

  void DrawRoom();
  void DrawFurniture();
  Eigen::Vector3d DrawPlace();
  bool DrawSources();
  bool DrawPath(const FreeFloor& floor);
  json DrawArray();
  void DrawPeople(const FreeFloor& floor);

  const std::uint64_t seed_;
  std::mt19937_64 engine_;
  Eigen::Vector3d room_m_;
  std::vector<Box> furniture_;
  std::vector<Eigen::Vector3d> source_m_;
  json scene_;
};

void Draw::DrawRoom() {
  const double length_m = LogUniform(4.0, 20.0);
  const double width_m = std::clamp(length_m * Uniform(0.5, 1.0), 4.0, 20.0);
  const double highest_m = 3.0 + 0.15 * width_m;
  room_m_ = {length_m, width_m, Uniform(2.5, highest_m)};
  if (Chance(0.5)) std::swap(room_m_.x(), room_m_.y());
  scene_["room_m"] = ToJson(room_m_);
  scene_["reverberation"] = {{"rt60_s", Uniform(0.2, 0.9)}, {"image_order", 2}};
}

// Cabinets along the walls, machines anywhere.
void Draw::DrawFurniture() {
  const double area_m2 = room_m_.x() * room_m_.y();
  const int cabinets = Integer(1, area_m2 > 60.0 ? 5 : 3);
  for (int i = 0; i < cabinets; ++i) {
    const int along = Integer(0, 1), across = 1 - along;
    const double width_m = Uniform(0.6, std::min(3.0, 0.6 * room_m_[along]));
    const double depth_m = Uniform(0.3, 0.8);
    Box box{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    box.min_m[along] = Uniform(0.0, room_m_[along] - width_m);
    box.max_m[along] = box.min_m[along] + width_m;
    box.min_m[across] = Chance(0.5) ? 0.0 : room_m_[across] - depth_m;
    box.max_m[across] = box.min_m[across] + depth_m;
    box.max_m.z() = Uniform(0.5, std::min(2.2, room_m_.z() - 0.3));
    furniture_.push_back(box);
  }
  const int machines = Integer(0, area_m2 > 150.0 ? 5 : area_m2 > 40.0 ? 3 : 1);
  for (int i = 0; i < machines; ++i) {
    const Eigen::Vector3d size_m(Uniform(0.6, 2.0), Uniform(0.6, 2.0), Uniform(0.6, 1.8));
    const Eigen::Vector3d corner_m(Uniform(0.3, room_m_.x() - size_m.x() - 0.3),
                                   Uniform(0.3, room_m_.y() - size_m.y() - 0.3), 0.0);
    furniture_.push_back({corner_m, corner_m + size_m});
  }
  scene_["furniture"] = json::array();
  for (const Box& box : furniture_) {
    scene_["furniture"].push_back({ToJson(box.min_m), ToJson(box.max_m)});
  }
}

// A point on the ceiling, on a wall, or on a side or the top of what stands there.
Eigen::Vector3d Draw::DrawPlace() {
  const double where = Uniform(0.0, 1.0);
  Eigen::Vector3d place(Uniform(0.5, room_m_.x() - 0.5), Uniform(0.5, room_m_.y() - 0.5),
                        room_m_.z());
  if (where < 0.35) return place;
  if (where < 0.65) {
    const int across = Integer(0, 1);
    place[across] = Chance(0.5) ? 0.0 : room_m_[across];
    place.z() = Uniform(0.5, room_m_.z() - 0.4);
    return place;
  }
  const Box& box = furniture_[Integer(0, static_cast<int>(furniture_.size()) - 1)];
  for (int axis = 0; axis < 3; ++axis) {
    place[axis] = Uniform(0.8 * box.min_m[axis] + 0.2 * box.max_m[axis],
                          0.2 * box.min_m[axis] + 0.8 * box.max_m[axis]);
  }
  if (box.max_m.z() < 1.6 && Chance(0.4)) {
    place.z() = box.max_m.z();
  } else {
    const int across = Integer(0, 1);
    place[across] = Chance(0.5) ? box.min_m[across] : box.max_m[across];
  }
  return place;
}

bool Draw::DrawSources() {
  const double area_m2 = room_m_.x() * room_m_.y();
  const int count = Integer(1, area_m2 > 40.0 ? 8 : area_m2 > 25.0 ? 5 : 3);
  scene_["sources"] = json::array();
  const auto fits = [&](const Eigen::Vector3d& place) {
    for (const Eigen::Vector3d& other : source_m_) {
      if ((other - place).norm() < kBetweenSources_m) return false;
    }
    // Covered by other furniture, or between it and a wall.
    int touching = 0;
    for (const Box& box : furniture_) {
      const Eigen::Array3d inside = (place - box.min_m).array().min((box.max_m - place).array());
      if (inside.minCoeff() > 0.01) return false;
      touching += inside.minCoeff() > -0.1;
    }
    const Eigen::Array3d from_walls = place.array().min((room_m_ - place).array());
    touching += (from_walls < 0.1).count() > 0;
    return touching == 1;
  };
  for (int trial = 0; trial < kTrials && static_cast<int>(source_m_.size()) < count; ++trial) {
    const Eigen::Vector3d place = DrawPlace();
    if (!fits(place)) continue;
    source_m_.push_back(place);
    constexpr const char* kKinds[] = {"fan",     "fan",   "hiss",   "hum",
                                      "machine", "motor", "speech", "white"};
    const std::string kind = kKinds[Integer(0, 7)];
    json source = {{"kind", kind},
                   {"position", ToJson(place)},
                   {"level", std::pow(10.0, -Uniform(0.0, 12.0) / 20.0)},
                   {"extent_m", kind == "fan" ? Uniform(0.2, 0.6)
                                : Chance(0.5) ? 0.0
                                              : 0.15},
                   {"directivity_db", Uniform(0.0, 5.0)}};
    if (Chance(0.15)) source["on_s"] = Uniform(5.0, 15.0);
    if (Chance(0.1)) source["off_s"] = Uniform(25.0, 40.0);
    scene_["sources"].push_back(source);
  }
  return !source_m_.empty();
}

// Past each source, by the nearest first, then about until the drive is long enough.
bool Draw::DrawPath(const FreeFloor& floor) {
  std::vector<Eigen::Vector2d> stands;
  for (const Eigen::Vector3d& source_m : source_m_) {
    const double least_m = std::min(1.0, 0.2 * room_m_.head<2>().minCoeff());
    for (int trial = 0; trial < kTrials; ++trial) {
      const double angle_rad = Uniform(-kPi, kPi);
      const double distance_m = Uniform(least_m, 3.0);
      const Eigen::Vector2d stand =
          source_m.head<2>() +
          distance_m * Eigen::Vector2d(std::cos(angle_rad), std::sin(angle_rad));
      if (!floor.IsFree(stand)) continue;
      stands.push_back(stand);
      break;
    }
  }
  const auto somewhere = [&]() -> std::optional<Eigen::Vector2d> {
    for (int trial = 0; trial < kTrials; ++trial) {
      const Eigen::Vector2d place(Uniform(0.0, room_m_.x()), Uniform(0.0, room_m_.y()));
      if (floor.IsFree(place)) return place;
    }
    return std::nullopt;
  };
  const auto start = somewhere();
  if (!start) return false;
  std::vector<Eigen::Vector2d> path = {*start};
  double length_m = 0.0;
  // False where the way there is too short, or the robot would have to turn on the spot.
  const auto go_to = [&](const Eigen::Vector2d& place) {
    if ((place - path.back()).norm() < 0.7) return false;
    const auto leg = floor.ShortestPath(path.back(), place);
    if (leg.size() < 2) return false;
    if (path.size() > 1) {
      const Eigen::Vector2d before = (path.back() - path[path.size() - 2]).normalized();
      if (before.dot((leg[1] - leg[0]).normalized()) < std::cos(kSharpestTurn_rad)) return false;
    }
    for (std::size_t i = 1; i < leg.size(); ++i) {
      length_m += (leg[i] - path.back()).norm();
      path.push_back(leg[i]);
    }
    return true;
  };
  while (length_m < (stands.empty() ? kShortestPath_m : kLongestPath_m)) {
    std::stable_sort(stands.begin(), stands.end(), [&](const auto& a, const auto& b) {
      return (a - path.back()).norm() < (b - path.back()).norm();
    });
    const auto reached = std::find_if(stands.begin(), stands.end(), go_to);
    if (reached != stands.end()) {
      stands.erase(reached);
      continue;
    }
    bool on_the_way = false;
    for (int trial = 0; trial < kTrials && !on_the_way; ++trial) {
      const auto place = somewhere();
      on_the_way = place && go_to(*place);
    }
    if (!on_the_way) break;
  }
  if (length_m < 0.5 * kShortestPath_m) return false;
  json points = json::array();
  for (const Eigen::Vector2d& point : path) points.push_back({point.x(), point.y()});
  scene_["path"] = {{"way_points", points},
                    {"closed", false},
                    {"speed_mps", Uniform(0.5, 0.7)},
                    {"turn_smoothing_m", 0.5}};
  return true;
}

json Draw::DrawArray() {
  const bool planar = seed_ % 3 == 0;
  constexpr int kCounts[] = {8, 16, 32};
  const int count = kCounts[seed_ / 3 % 3];
  const double radius_m = Uniform(0.08, 0.2);
  std::vector<Eigen::Vector3d> microphone_m;
  if (planar) {
    if (count == 8 || Chance(0.3)) {
      microphone_m = MakeArray(ArrayShape::kRing, count, radius_m, 0.0);
    } else {
      microphone_m = MakeArray(ArrayShape::kRing, count / 2, radius_m, 0.0);
      const double turn_rad = 2.0 * kPi / count;
      for (const auto& outer : MakeArray(ArrayShape::kRing, count / 2, 0.6 * radius_m, 0.0)) {
        microphone_m.push_back(Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ()) * outer);
      }
    }
  } else {
    const int shape = Integer(0, count == 8 ? 2 : 1);
    microphone_m = MakeArray(shape == 0   ? ArrayShape::kTwoRings
                             : shape == 1 ? ArrayShape::kSphere
                                          : ArrayShape::kCube,
                             count, radius_m, Uniform(0.6, 1.4) * radius_m);
  }
  json array;
  array["position_m"] = {Uniform(-0.1, 0.15), Uniform(-0.05, 0.05), Uniform(1.0, 1.3)};
  array["rpy_deg"] = {Chance(0.3) ? Uniform(-180.0, 180.0) : 0.0,
                      Chance(0.3) ? Uniform(-90.0, 90.0) : 0.0, Uniform(-180.0, 180.0)};
  array["microphones_m"] = json::array();
  for (const Eigen::Vector3d& m : microphone_m) array["microphones_m"].push_back(ToJson(m));
  return array;
}

// One or two, where they do not meet the robot.
void Draw::DrawPeople(const FreeFloor& floor) {
  const auto scene = ParseScene(scene_.dump(), "random", "");
  if (!scene.ok()) return;
  const auto robot = Trajectory::Create(scene->path, 1.0);
  if (!robot.ok()) return;
  json people = json::array();
  const int count = Integer(1, 2);
  for (int trial = 0; trial < kTrials && static_cast<int>(people.size()) < count; ++trial) {
    PersonConfig person;
    person.speed_mps = Uniform(0.4, 1.2);
    const Eigen::Vector2d from(Uniform(0.3, room_m_.x() - 0.3), Uniform(0.3, room_m_.y() - 0.3));
    const Eigen::Vector2d to(Uniform(0.3, room_m_.x() - 0.3), Uniform(0.3, room_m_.y() - 0.3));
    person.way_points_m = floor.ShortestPath(from, to);
    if (person.way_points_m.size() < 2) continue;
    bool meets = false;
    for (double time_s = 0.0; time_s < robot->duration_s() && !meets; time_s += 0.1) {
      const PlanarPose pose = robot->At(time_s);
      meets = (PersonPosition(person, time_s) - Eigen::Vector2d(pose.x_m, pose.y_m)).norm() <
              kRobotFromPerson_m;
    }
    if (meets) continue;
    json points = json::array();
    for (const auto& point : person.way_points_m) points.push_back({point.x(), point.y()});
    people.push_back({{"way_points", points}, {"speed_mps", person.speed_mps}});
  }
  if (!people.empty()) scene_["people"] = people;
}

std::optional<json> Draw::Make() {
  DrawRoom();
  DrawFurniture();
  if (!DrawSources()) return std::nullopt;
  const FreeFloor floor(room_m_, furniture_, kRobotRadius_m);
  if (floor.free_share() < 0.25 || !DrawPath(floor)) return std::nullopt;
  scene_["array"] = DrawArray();
  scene_["audio"] = {{"sample_rate_hz", Chance(0.75) ? 16000 : 24000},
                     {"chunk_s", 0.05},
                     {"sensor_noise", LogUniform(0.01, 0.06)},
                     {"robot_noise", Chance(0.5) ? LogUniform(0.002, 0.02) : 0.0},
                     {"clock_drift_ppm", Uniform(-30.0, 30.0)}};
  scene_["lidar"] = {{"position_m", {0.0, 0.0, 1.5}},      {"rings", Integer(36, 48)},
                     {"elevation_deg", {-25.0, 85.0}},     {"azimuth_step_deg", Uniform(0.9, 1.3)},
                     {"rate_hz", Chance(0.5) ? 2.0 : 5.0}, {"swept", Chance(0.5)}};
  scene_["laser"] = {{"position_m", {0.2, 0.0, 0.3}}, {"beams", 541}, {"rate_hz", 10}};
  scene_["odometry"] = {{"rate_hz", 20},
                        {"translation_scale", Uniform(0.98, 1.02)},
                        {"yaw_drift_rad_per_m", Uniform(-0.01, 0.01)}};
  scene_["seed"] = seed_;
  if (Chance(0.3)) DrawPeople(floor);
  return ParseScene(scene_.dump(), "random", "").ok() ? std::optional(scene_) : std::nullopt;
}

}  // namespace

absl::StatusOr<std::string> RandomScene(std::uint64_t seed) {
  for (std::uint32_t trial = 0; trial < kTrials; ++trial) {
    if (const auto scene = Draw(seed, trial).Make()) return scene->dump(1) + "\n";
  }
  return absl::InternalError(absl::StrCat("no room of seed ", seed, " can be driven through"));
}

}  // namespace soundmap::simulation
