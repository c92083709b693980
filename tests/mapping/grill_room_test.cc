#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "geometry/angles.h"
#include "mapping/mapper.h"
#include "tests/mapping/box_room.h"
#include "tests/mapping/recorded_drive.h"

namespace soundmap::mapping {
namespace {

Eigen::Vector3d ToVector(const nlohmann::json& json) {
  return {json[0].get<double>(), json[1].get<double>(), json[2].get<double>()};
}

// A drive made by another program, whose room and path are known.
TEST(GrillRoom, PathAndWallsAgreeWithTheTruth) {
  const char* data = std::getenv("SOUNDMAP_DATA");
  const std::string folder =
      std::string(data ? data : SOUNDMAP_SOURCE_DIR "/../shared/data") + "/grill_room/";
  if (!std::filesystem::exists(folder + "mapping.mcap")) {
    GTEST_SKIP() << "the sample drive is not there: " << folder << "mapping.mcap";
  }
  const auto drive = ReadDrive(folder + "mapping.mcap");
  ASSERT_TRUE(drive.ok()) << drive.status();
  std::ifstream file(folder + "mapping.truth.json");
  const auto truth = nlohmann::json::parse(file);
  const Eigen::Vector3d start = ToVector(truth["start_pose"]);
  std::vector<Box> obstacles;
  for (const auto& box : truth["obstacles"]) {
    obstacles.push_back({ToVector(box[0]), ToVector(box[1])});
  }
  const BoxRoom room(ToVector(truth["room"]), obstacles);

  auto mapper = Mapper::Create({}, drive->calibration, {start.x(), start.y(), start.z()});
  ASSERT_TRUE(mapper.ok()) << mapper.status();
  for (const frames::Frame& frame : drive->frames) ASSERT_TRUE(mapper->Add(frame).ok());
  const auto result = mapper->Finish();
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->report.scans_dropped, 0);
  EXPECT_EQ(result->report.scans_unregistered, 0);
  EXPECT_GT(result->report.drift_removed_m, 0.3);

  double error_sum_m = 0.0, yaw_error_max_rad = 0.0;
  for (const StampedPose& pose : result->report.path) {
    const geometry::Pose2 true_pose = PoseAt(drive->truth, pose.stamp_ns);
    error_sum_m +=
        std::hypot(pose.map_from_base.x_m - true_pose.x_m, pose.map_from_base.y_m - true_pose.y_m);
    yaw_error_max_rad = std::max(
        yaw_error_max_rad,
        std::abs(geometry::NormalizeAngle(pose.map_from_base.yaw_rad - true_pose.yaw_rad)));
  }
  ASSERT_GT(result->report.path.size(), 100u);
  EXPECT_LT(error_sum_m / static_cast<double>(result->report.path.size()), 0.005);
  EXPECT_LT(yaw_error_max_rad, geometry::RadFromDeg(0.1));

  octomap::OcTree voxels(*result->building.octree);
  voxels.expand();
  int occupied = 0, near = 0, far = 0, free = 0, free_in_solid = 0;
  for (auto voxel = voxels.begin_leafs(); voxel != voxels.end_leafs(); ++voxel) {
    const double distance_m = room.SignedDistance({voxel.getX(), voxel.getY(), voxel.getZ()});
    if (voxels.isNodeOccupied(*voxel)) {
      ++occupied;
      near += std::abs(distance_m) <= 0.05 + 1e-6;
      far += std::abs(distance_m) > 0.1;
    } else {
      ++free;
      free_in_solid += distance_m < -0.05;
    }
  }
  // Walls, floor and ceiling have 232 m2, at one to two voxels of 25 cm2 each.
  EXPECT_GT(occupied, 90000);
  EXPECT_GT(static_cast<double>(near) / occupied, 0.995);
  EXPECT_EQ(far, 0);
  EXPECT_EQ(free_in_solid, 0);
  EXPECT_GT(free, 1300000);
}

}  // namespace
}  // namespace soundmap::mapping
