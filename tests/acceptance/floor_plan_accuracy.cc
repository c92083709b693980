// Floor plans from the shared logs of LRF and odometry alone: how good the path is, how long it
// takes. floor_plan_accuracy LOG [--lag S] [--poses FILE] [--truth FILE] [--relations FILE] [--pgm
// FILE]

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <string>

#include "building/ros_map.h"
#include "mapping/floor_plan_mapper.h"
#include "tests/mapping/laser_drive.h"

using namespace soundmap;
using namespace soundmap::mapping;

int main(int argc, char** argv) {
  CLI::App app("Accuracy of the floor plan from an LRF and odometry");
  std::string log, poses, truth, relations, pgm, path;
  FloorPlanMapperConfig config;
  app.add_option("LOG", log)->required();
  app.add_option("--lag", config.laser_lag_s);
  app.add_option("--poses", poses);
  app.add_option("--truth", truth);
  app.add_option("--relations", relations);
  app.add_option("--pgm", pgm);
  app.add_option("--path", path);
  app.add_option("--relax", config.relaxation_passes);
  app.add_option("--piece", config.wall_piece_m);
  app.add_option("--local", config.local_map_m);
  app.add_option("--key", config.key_scan_distance_m);
  app.add_option("--key-angle", config.key_scan_angle_rad);
  app.add_option("--stretch", config.stretch_m);
  app.add_option("--max-range", config.max_range_m);
  CLI11_PARSE(app, argc, argv);

  const auto drive = ReadCarmenDrive(log);
  if (!drive.ok()) {
    std::fprintf(stderr, "%s\n", std::string(drive.status().message()).c_str());
    return 1;
  }
  const auto begin = std::chrono::steady_clock::now();
  auto mapper =
      FloorPlanMapper::Create(config, drive->calibration, {},
                              poses.empty() ? std::vector<StampedPose>{} : ReadPoses(poses));
  absl::Status status = mapper.status();
  for (const frames::Frame& frame : drive->frames) {
    if (status.ok()) status = mapper->Add(frame);
  }
  const auto middle = std::chrono::steady_clock::now();
  auto result = status.ok() ? mapper->Finish() : status;
  if (!result.ok()) {
    std::fprintf(stderr, "%s\n", std::string(result.status().message()).c_str());
    return 1;
  }
  const auto end = std::chrono::steady_clock::now();
  const FloorPlanReport& report = result->report;
  const double drive_s =
      frames::SecondsFromNs(report.path.back().stamp_ns - report.path.front().stamp_ns);
  const double front_s = std::chrono::duration<double>(middle - begin).count();
  const double total_s = std::chrono::duration<double>(end - begin).count();
  std::printf(
      "scans %d dropped %d unregistered %d key scans %d loops %d refused %d residual %.4f m drift "
      "%.2f m\n",
      report.scans, report.scans_dropped, report.scans_unregistered, report.key_scans,
      report.loops_closed, report.loops_refused, report.mean_residual_m, report.drift_removed_m);
  std::printf("lag %.3f s; %.1f s (front end %.1f s), %.0f x real time; plan %d x %d\n",
              report.laser_lag_s, total_s, front_s, drive_s / total_s,
              result->building.floor_plan.width(), result->building.floor_plan.height());
  if (!relations.empty()) {
    const RelationsError error = ErrorOfRelations(report.path, ReadRelations(relations));
    std::printf("relations %.4f +- %.4f m, %.3f deg over %d\n", error.mean_m, error.std_m,
                error.mean_deg, error.relations);
  }
  if (!truth.empty()) {
    const PathError error = ErrorOfPath(report.path, ReadPoses(truth));
    std::printf("against poses: mean %.3f m max %.3f m, %.3f deg over %d\n", error.mean_m,
                error.max_m, error.mean_deg, error.poses);
  }
  if (!path.empty()) {
    std::ofstream file(path);
    file.precision(15);
    for (const StampedPose& pose : report.path) {
      file << static_cast<double>(pose.stamp_ns) * 1e-9 << ',' << pose.map_from_base.x_m << ','
           << pose.map_from_base.y_m << ',' << pose.map_from_base.yaw_rad << '\n';
    }
  }
  if (!pgm.empty()) {
    std::ofstream(pgm, std::ios::binary)
        << building::ToRosMap(result->building.floor_plan, "plan.pgm").pgm;
  }
}
