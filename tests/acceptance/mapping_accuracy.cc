// Measures mapping against the truth: `mapping_accuracy hall|pair|swept|people|ring [--seeds N]`.
#include <octomap/OcTree.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iterator>
#include <set>
#include <string>

#include "building/files.h"
#include "building/point_cloud_file.h"
#include "geometry/angles.h"
#include "mapping/mapper.h"
#include "mapping/registration.h"
#include "tests/mapping/box_room.h"

namespace soundmap::mapping {
namespace {

using frames::Frame;
using geometry::Pose2;

std::string DataFolder() {
  const char* data = std::getenv("SOUNDMAP_DATA");
  return data ? data : SOUNDMAP_SOURCE_DIR "/../shared/data";
}

double Seconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;  // of the one core, whoever else works
}

double Seconds(frames::TimeNs stamp_ns) { return frames::SecondsFromNs(stamp_ns - kDriveStart_ns); }

struct PathError {
  double rmse_m = 0.0, max_m = 0.0, max_deg = 0.0;
  double aligned_rmse_m = 0.0;  // after the best rigid motion
};

PathError ErrorOf(std::span<const StampedPose> path, const DriveModel& model) {
  PathError error;
  Eigen::MatrixXd found(2, path.size()), truth(2, path.size());
  for (std::size_t i = 0; i < path.size(); ++i) {
    const Pose2 pose = path[i].map_from_base;
    const Pose2 true_pose = model.MapFromBase(Seconds(path[i].stamp_ns));
    const auto column = static_cast<Eigen::Index>(i);
    found.col(column) = Eigen::Vector2d(pose.x_m, pose.y_m);
    truth.col(column) = Eigen::Vector2d(true_pose.x_m, true_pose.y_m);
    error.max_deg = std::max(
        error.max_deg,
        geometry::DegFromRad(std::abs(geometry::NormalizeAngle(pose.yaw_rad - true_pose.yaw_rad))));
  }
  const auto n = static_cast<double>(path.size());
  error.rmse_m = std::sqrt((found - truth).squaredNorm() / n);
  error.max_m = (found - truth).colwise().norm().maxCoeff();
  const Eigen::Matrix3d motion = Eigen::umeyama(found, truth, /*with_scaling=*/false);
  const Eigen::Matrix2Xd moved =
      (motion.topLeftCorner<2, 2>() * found).colwise() + motion.topRightCorner<2, 1>();
  error.aligned_rmse_m = std::sqrt((moved - truth).squaredNorm() / n);
  return error;
}

absl::StatusOr<MappingResult> Map(const std::vector<Frame>& drive, const DriveModel& model,
                                  const MapperConfig& config, double& speed) {
  auto mapper = Mapper::Create(config, model.Calibration(), model.MapFromBase(0.0));
  if (!mapper.ok()) return mapper.status();
  const double begin_s = Seconds();
  for (const Frame& frame : drive) mapper->Add(frame).IgnoreError();
  auto result = mapper->Finish();
  speed = model.duration_s / (Seconds() - begin_s);
  return result;
}

void Print(const char* name, unsigned seed, const MappingResult& result, const DriveModel& model,
           double speed) {
  const PathError error = ErrorOf(result.report.path, model);
  const MappingReport& report = result.report;
  std::printf(
      "%-8s seed %u: scans %d unregistered %d key %d  ATE %.4f (aligned %.4f) max %.4f m %.2f deg  "
      "residual %.4f m  drift removed %.2f m  loops %d tried %d closed %d refused  %.1fx real "
      "time\n",
      name, seed, report.scans, report.scans_unregistered, report.key_scans, error.rmse_m,
      error.aligned_rmse_m, error.max_m, error.max_deg, report.mean_residual_m,
      report.drift_removed_m, report.loops_tried, report.loops_closed, report.loops_refused, speed);
  std::fflush(stdout);
}

bool NearOccupied(const octomap::OcTree& octree, const octomap::OcTreeKey& key, int reach) {
  for (int x = -reach; x <= reach; ++x) {
    for (int y = -reach; y <= reach; ++y) {
      for (int z = -reach; z <= reach; ++z) {
        const auto* node = octree.search(octomap::OcTreeKey(key[0] + x, key[1] + y, key[2] + z));
        if (node && octree.isNodeOccupied(node)) return true;
      }
    }
  }
  return false;
}

void Hall(unsigned seeds) {
  const auto hall = building::ImportBuilding(DataFolder() + "/catec/catec.bt", {});
  if (!hall.ok()) {
    std::printf("%s\n", std::string(hall.status().message()).c_str());
    return;
  }
  const octomap::OcTree& truth = *hall->octree;
  const World world = [&](const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
    const octomap::point3d from(origin.x(), origin.y(), origin.z());
    const octomap::point3d along(direction.x(), direction.y(), direction.z());
    octomap::point3d centre, surface;
    if (!truth.castRay(from, along, centre, /*ignoreUnknownCells=*/true, 20.0) ||
        !truth.getRayIntersection(from, along, centre, surface)) {
      return std::numeric_limits<double>::infinity();
    }
    return static_cast<double>((surface - from).norm());
  };
  const DriveModel model{.duration_s = 80.0,
                         .lap_s = 40.0,
                         .centre = {0.0, -0.3},
                         .radius = {5.0, 3.0},
                         .lidar_period_s = 0.5,
                         .rings = 40,
                         .columns = 720,
                         .range_noise_m = 0.01,
                         .odometry_scale = 0.97,
                         .odometry_yaw_scale = 0.97};
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    const auto drive = SimulateDrive(world, model, seed);
    double speed = 0.0;
    const auto result = Map(drive, model, {}, speed);
    if (!result.ok()) {
      std::printf("hall seed %u: %s\n", seed, std::string(result.status().message()).c_str());
      continue;
    }
    Print("hall", seed, *result, model, speed);
    octomap::OcTree found(*result->building.octree);
    found.expand();
    int occupied = 0, ghosts = 0, far_ghosts = 0;
    for (auto leaf = found.begin_leafs(); leaf != found.end_leafs(); ++leaf) {
      if (!found.isNodeOccupied(*leaf)) continue;
      ++occupied;
      ghosts += !NearOccupied(truth, leaf.getKey(), 1);
      far_ghosts += !NearOccupied(truth, leaf.getKey(), 2);
    }
    // What was seen: the voxels that the true rays end in, without noise.
    DriveModel exact = model;
    exact.range_noise_m = 0.0;
    std::set<std::array<int, 3>> seen;
    for (const Frame& frame : SimulateDrive(world, exact, seed)) {
      const auto* scan = std::get_if<frames::LidarScan>(&frame);
      if (!scan) continue;
      for (std::size_t i = 0; i < scan->point_in_lidar.size(); ++i) {
        const double time_s = Seconds(scan->stamp_ns + scan->time_offset_ns[i]);
        const Eigen::Isometry3d map_from_lidar =
            model.MapFromBase(time_s).ToIsometry() * model.base_from_lidar;
        // A little deeper, since it lies on the voxel's face.
        const Eigen::Vector3d point =
            map_from_lidar * (scan->point_in_lidar[i].cast<double>() *
                              (1.0 + 1e-3 / scan->point_in_lidar[i].norm()));
        const octomap::OcTreeKey key = truth.coordToKey(point.x(), point.y(), point.z());
        seen.insert({key[0], key[1], key[2]});
      }
    }
    int surface = 0, mapped = 0;
    for (const auto& key : seen) {
      const octomap::OcTreeKey voxel(key[0], key[1], key[2]);
      if (!NearOccupied(truth, voxel, 0)) continue;
      ++surface;
      mapped += NearOccupied(found, voxel, 1);
    }
    std::printf(
        "         surface voxels seen %d, within one voxel %.2f %%; occupied %d, ghosts %.2f %% "
        "(beyond two voxels %.2f %%)\n",
        surface, 100.0 * mapped / surface, occupied, 100.0 * ghosts / occupied,
        100.0 * far_ghosts / occupied);
  }
}

std::vector<Eigen::Vector3f> ReadPly(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  const auto points = building::ParsePly(bytes);
  std::vector<Eigen::Vector3f> result;
  if (!points.ok()) return result;
  for (const Eigen::Vector3d& point : *points) result.push_back(point.cast<float>());
  return result;
}

void Pair(int starts) {
  const std::string folder = DataFolder() + "/registration_pair/";
  const auto source = ReadPly(folder + "source.ply");
  Eigen::Isometry3d truth;
  std::ifstream matrix(folder + "T_target_source.txt");
  for (int i = 0; i < 16; ++i) matrix >> truth.matrix()(i / 4, i % 4);
  SurfacePyramid map(0.4, 4);
  map.Insert(ReadPly(folder + "target.ply"));
  map.FitPlanes();
  std::mt19937 random(1);
  std::normal_distribution<double> any(0.0, 1.0);
  int good = 0;
  double worst_m = 0.0, worst_deg = 0.0;
  const double begin_s = Seconds();
  for (int i = 0; i < starts; ++i) {
    const Eigen::Vector3d shift(any(random), any(random), any(random));
    const Eigen::Vector3d axis(any(random), any(random), any(random));
    Eigen::Isometry3d start = truth;
    start.translation() += shift.normalized();
    start.linear() =
        Eigen::AngleAxisd(geometry::RadFromDeg(10.0), axis.normalized()) * truth.linear();
    const Registration found = RegisterFromFar(source, map, start,
                                               {.start_distance_m = 4.0,
                                                .prior_std_m = 1.0,
                                                .prior_std_rad = 0.17,
                                                .prior_std_z_m = 1.0,
                                                .prior_std_tilt_rad = 0.17});
    const Eigen::Isometry3d off = found.map_from_base.inverse() * truth;
    const double off_m = off.translation().norm();
    const double off_deg = geometry::DegFromRad(Eigen::AngleAxisd(off.linear()).angle());
    const bool is_good = off_m < 0.05 && off_deg < 0.3;
    good += is_good;
    if (is_good) {
      worst_m = std::max(worst_m, off_m);
      worst_deg = std::max(worst_deg, off_deg);
    } else {
      std::printf("  start %d: %.2f m %.1f deg, fit %.2f overlap %.2f\n", i, off_m, off_deg,
                  found.fit(), found.overlap);
    }
  }
  std::printf(
      "pair: %d of %d within 0.05 m and 0.3 deg (of these at most %.4f m, %.3f deg), %.0f ms "
      "each\n",
      good, starts, worst_m, worst_deg, 1e3 * (Seconds() - begin_s) / starts);
}

DriveModel TurningModel(bool swept) {
  return {.duration_s = 19.0,
          .lap_s = 6.3,
          .radius = {1.6, 1.2},
          .lidar_period_s = 0.1,
          .swept = swept,
          .rings = 40,
          .columns = 720,
          .range_noise_m = 0.01,
          .odometry_scale = 0.97,
          .odometry_yaw_scale = 0.97};
}

void Swept(unsigned seeds) {
  const BoxRoom room({12.0, 9.0, 2.7},
                     {{{9.0, 6.0, 0.0}, {10.0, 8.0, 1.0}}, {{0.0, 0.0, 0.0}, {1.0, 2.0, 1.8}}});
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    for (const char* kind : {"instant", "swept", "bent"}) {
      const DriveModel model = TurningModel(kind[0] != 'i');
      auto drive = SimulateDrive(room, model, seed);
      if (kind[0] == 'b') {
        for (Frame& frame : drive) {
          if (auto* scan = std::get_if<frames::LidarScan>(&frame)) scan->time_offset_ns.clear();
        }
      }
      double speed = 0.0;
      const auto result = Map(drive, model, {}, speed);
      if (!result.ok()) continue;
      Print(kind, seed, *result, model, speed);
    }
  }
}

void People(unsigned seeds) {
  const BoxRoom room = BoxRoom::WithFurniture();
  const Walker walkers[] = {{{1.2, 4.8}, {6.0, 4.6}, 11.0}, {{6.8, 0.8}, {6.2, 4.4}, 7.0}};
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    for (const bool people : {false, true}) {
      DriveModel model{.duration_s = 40.0,
                       .lidar_period_s = 0.2,
                       .rings = 40,
                       .columns = 720,
                       .range_noise_m = 0.01,
                       .odometry_scale = 0.97,
                       .odometry_yaw_scale = 0.97};
      if (people) {
        model.moving = [&](double time_s, const Eigen::Vector3d& origin,
                           const Eigen::Vector3d& direction) {
          return std::min(DistanceToWalker(walkers[0], time_s, origin, direction),
                          DistanceToWalker(walkers[1], time_s, origin, direction));
        };
      }
      double speed = 0.0;
      const auto result = Map(SimulateDrive(room, model, seed), model, {}, speed);
      if (!result.ok()) continue;
      Print(people ? "people" : "empty", seed, *result, model, speed);
      octomap::OcTree leaves(*result->building.octree);
      leaves.expand();
      int left = 0, occupied = 0;
      for (auto leaf = leaves.begin_leafs(); leaf != leaves.end_leafs(); ++leaf) {
        if (!leaves.isNodeOccupied(*leaf)) continue;
        ++occupied;
        if (room.SignedDistance({leaf.getX(), leaf.getY(), leaf.getZ()}) <= 0.1) continue;
        if (++left <= 10) std::printf("  (%.2f %.2f %.2f)", leaf.getX(), leaf.getY(), leaf.getZ());
      }
      std::printf("\n         occupied %d, in free space %d\n", occupied, left);
    }
  }
}

void Ring(unsigned seeds) {
  const BoxRoom room = RingCorridor(36, 26, 3);
  DriveModel model{.duration_s = 140.0,
                   .lidar_period_s = 0.5,
                   .rings = 24,
                   .columns = 360,
                   .range_noise_m = 0.015,
                   .odometry_scale = 0.97,
                   .odometry_yaw_scale = 0.97};
  model.path = [](double time_s) { return AlongRing(36, 26, 3, time_s); };
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    const auto drive = SimulateDrive(room, model, seed);
    for (const double max_range_m : {40.0, 10.0}) {
      double speed = 0.0;
      const auto result = Map(drive, model, {.max_range_m = max_range_m}, speed);
      if (!result.ok()) {
        std::printf("ring: %s\n", std::string(result.status().message()).c_str());
        continue;
      }
      Print(max_range_m > 20 ? "ring" : "ring10m", seed, *result, model, speed);
    }
  }
}

}  // namespace
}  // namespace soundmap::mapping

int main(int argc, char** argv) {
  CLI::App app("Accuracy of mapping against the truth");
  std::string what;
  unsigned seeds = 1;
  app.add_option("what", what, "hall, pair, swept, people or ring")->required();
  app.add_option("--seeds", seeds, "how many");
  CLI11_PARSE(app, argc, argv);
  using namespace soundmap::mapping;
  if (what == "hall") Hall(seeds);
  if (what == "pair") Pair(static_cast<int>(100 * seeds));
  if (what == "swept") Swept(seeds);
  if (what == "people") People(seeds);
  if (what == "ring") Ring(seeds);
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  std::printf("peak memory %ld MiB\n", usage.ru_maxrss / 1024);
}
