#include <octomap/OcTree.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <chrono>
#include <iostream>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "geometry/angles.h"
#include "mapping/mapper.h"
#include "tests/mapping/recorded_drive.h"

namespace soundmap::mapping {
namespace {

TEST(GrillRoom, Diag) {
  const char* data = std::getenv("SOUNDMAP_DATA");
  const std::string folder = std::string(data != nullptr ? data : SOUNDMAP_SOURCE_DIR "/../shared/data") + "/grill_room/";
  const auto drive = ReadDrive(folder + "mapping.mcap");
  ASSERT_TRUE(drive.ok()) << drive.status();
  std::ifstream file(folder + "mapping.truth.json");
  const auto truth = nlohmann::json::parse(file);
  const auto start = truth["start_pose"];
  auto now = [] { return std::chrono::steady_clock::now(); };
  auto sec = [](auto d) { return std::chrono::duration<double>(d).count(); };
  std::cout << "laser z " << drive->calibration.base_from_laser.translation().transpose() << " lidar " << drive->calibration.base_from_lidar.matrix() << "\n";
  for (const auto& f : drive->frames) if (auto* s = std::get_if<frames::LidarScan>(&f)) { std::cout << "points " << s->point_in_lidar.size() << " offs " << s->time_offset_ns.size() << "\n"; break; }
  MapperConfig config;
  if (getenv("SV")) config.surface_voxel_size_m = atof(getenv("SV"));
  if (getenv("RP")) config.relaxation_passes = atoi(getenv("RP"));
  if (getenv("KD")) config.key_scan_distance_m = atof(getenv("KD"));
  auto t0 = now();
  auto mapper = Mapper::Create(config, drive->calibration, {start[0], start[1], start[2]});
  ASSERT_TRUE(mapper.ok()) << mapper.status();
  for (const auto& frame : drive->frames) ASSERT_TRUE(mapper->Add(frame).ok());
  auto t1 = now();
  auto result = mapper->Finish([&](double p) { static double l = 0; if (p >= l + 0.1) { l = p; std::cout << "  " << p << " at " << sec(now() - t1) << "\n"; } return true; });
  auto t2 = now();
  ASSERT_TRUE(result.ok()) << result.status();
  const auto& r = result->report;
  double sum = 0, maxe = 0, sy = 0, my = 0; Eigen::Vector3d bias(0,0,0);
  for (const auto& p : r.path) {
    auto t = PoseAt(drive->truth, p.stamp_ns);
    double e = std::hypot(t.x_m - p.map_from_base.x_m, t.y_m - p.map_from_base.y_m);
    double y = geometry::NormalizeAngle(p.map_from_base.yaw_rad - t.yaw_rad);
    bias += Eigen::Vector3d(p.map_from_base.x_m - t.x_m, p.map_from_base.y_m - t.y_m, y);
    sum += e; maxe = std::max(maxe, e); sy += std::abs(y); my = std::max(my, std::abs(y));
    if (getenv("VERB")) std::cout << p.stamp_ns * 1e-9 << " " << e << " yaw " << geometry::DegFromRad(y) << "\n";
  }
  int n = r.path.size();
  std::cout << "scans " << r.scans << " dropped " << r.scans_dropped << " unreg " << r.scans_unregistered << " key " << r.key_scans << " resid " << r.mean_residual_m << " drift " << r.drift_removed_m << "\n";
  std::cout << "pos mean " << sum / n << " max " << maxe << " yaw mean deg " << geometry::DegFromRad(sy / n) << " max " << geometry::DegFromRad(my) << " bias " << (bias / n).transpose() << "\n";
  std::cout << "add " << sec(t1 - t0) << " s, finish " << sec(t2 - t1) << " s\n";
  // octree vs boxes
  struct Box { Eigen::Vector3d lo, hi; };
  std::vector<Box> obstacles;
  for (auto& o : truth["obstacles"]) { auto v = [](const nlohmann::json& j) { return Eigen::Vector3d(j[0].get<double>(), j[1].get<double>(), j[2].get<double>()); }; obstacles.push_back({v(o[0]), v(o[1])}); }
  Eigen::Vector3d room(truth["room"][0].get<double>(), truth["room"][1].get<double>(), truth["room"][2].get<double>());
  long occ = 0, within = 0, within2 = 0, freec = 0, bad_free = 0; std::map<int,int> hist;
  auto& tree = *result->building.octree;
  octomap::OcTree full(tree); full.expand();
  for (auto it = full.begin_leafs(); it != full.end_leafs(); ++it) {
    Eigen::Vector3d c(it.getX(), it.getY(), it.getZ());
    auto boxdist = [&](const Box& b) { Eigen::Vector3d q = (b.lo - c).cwiseMax(c - b.hi); double out = q.cwiseMax(0).norm(); double in = std::min(q.maxCoeff(), 0.0); return out + in; };
    double d = std::abs(boxdist({Eigen::Vector3d::Zero(), room}));
    double sd = -boxdist({Eigen::Vector3d::Zero(), room}); // positive inside room
    for (auto& o : obstacles) { d = std::min(d, std::abs(boxdist(o))); sd = std::min(sd, boxdist(o)); }
    if (full.isNodeOccupied(*it)) { ++occ; hist[std::min(20, (int)(d / 0.025))]++; if (d <= 0.05) ++within; if (d <= 0.1) ++within2; }
    else { ++freec; if (sd < -0.05) ++bad_free; }
  }
  std::cout << "occ " << occ << " within 1 voxel " << (double)within / occ << " 2 " << (double)within2 / occ << " free " << freec << " free behind surface " << bad_free << " nodes " << tree.size() << "\n";
  for (auto& [k, v] : hist) std::cout << k * 0.025 << ": " << v << "\n";
  // plan print
  auto& plan = result->building.floor_plan;
  std::cout << plan.width() << " x " << plan.height() << " origin " << plan.origin_in_map_m().transpose() << "\n";
  for (int row = plan.height() - 1; row >= 0; row -= 3) { for (int c = 0; c < plan.width(); c += 2) std::cout << " .#"[(int)plan.at(c, row)]; std::cout << "\n"; }
}

}  // namespace
}  // namespace soundmap::mapping
