#include "cli/pose_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <numbers>

#include "absl/strings/match.h"

namespace soundmap::cli {
namespace {

std::string WriteFile(const std::string& name, const std::string& text) {
  const std::string path = ::testing::TempDir() + name;
  std::ofstream(path, std::ios::binary) << text;
  return path;
}

TEST(ReadPoseFile, ReadsCsv) {
  const auto poses = ReadPoseFile(WriteFile("poses.csv",
                                            "# from the total station\n"
                                            "timestamp_s,x,y,yaw\n"
                                            "\n"
                                            "1000.25, 1.5,-2,0.5  # start\r\n"
                                            "1000.350000,1.6,-2,-3.5\n"));
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->size(), 2u);
  EXPECT_EQ((*poses)[0].time_ns, 1'000'250'000'000);
  EXPECT_EQ((*poses)[0].map_from_base.x_m, 1.5);
  EXPECT_EQ((*poses)[0].map_from_base.y_m, -2.0);
  EXPECT_EQ((*poses)[0].map_from_base.yaw_rad, 0.5);
  EXPECT_EQ((*poses)[1].time_ns, 1'000'350'000'000);
}

TEST(ReadPoseFile, ReadsTum) {
  // A quaternion (0, 0, sin(yaw/2), cos(yaw/2)) is a turn by yaw about z.
  const double yaw_rad = -2.2;
  char line[200];
  std::snprintf(line, sizeof(line), "1.5 1 2 0.3 0 0 %.12f %.12f\n", std::sin(yaw_rad / 2),
                std::cos(yaw_rad / 2));
  const auto poses = ReadPoseFile(WriteFile("poses.tum", std::string("# tum\n") + line));
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->size(), 1u);
  EXPECT_EQ((*poses)[0].time_ns, 1'500'000'000);
  EXPECT_EQ((*poses)[0].map_from_base.x_m, 1.0);
  EXPECT_EQ((*poses)[0].map_from_base.y_m, 2.0);
  EXPECT_NEAR((*poses)[0].map_from_base.yaw_rad, yaw_rad, 1e-9);
}

TEST(ReadPoseFile, NamesTheLineOfWhatItRefuses) {
  const std::pair<const char*, const char*> cases[] = {
      {"1,2,3\n", ":1 is neither"},
      {"1,2,3,4,5\n", ":1 is neither"},
      {"1 2 3 4\n", ":1 is neither"},
      {"1,2,3,4\n1.5,nan,0,0\n", ":2: \"nan\""},
      {"1,2,inf,0\n", ":1: \"inf\""},
      {"1,2,x,0\n", ":1: \"x\""},
      {"1,,3,0\n", ":1: \"\""},
      {"1e99,2,3,0\n", ":1: \"1e99\""},
      {"2,0,0,0\n2,0,0,0\n", ":2: the time is not later"},
      {"2,0,0,0\n1,0,0,0\n", ":2: the time is not later"},
      {"1 0 0 0 0 0 0 0\n", ":1: the quaternion"},
      {"1 0 0 0 0 0 2 2\n", ":1: the quaternion"},
      {"", "holds no pose"},
      {"# only a comment\n", "holds no pose"},
      {"timestamp_s,x,y,yaw\n", "holds no pose"},
      {"a,b,c,d\na,b,c,d\n", ":2: \"a\""},
  };
  for (const auto& [text, sentence] : cases) {
    const auto poses = ReadPoseFile(WriteFile("hostile.csv", text));
    ASSERT_FALSE(poses.ok()) << text;
    EXPECT_EQ(poses.status().code(), absl::StatusCode::kInvalidArgument) << text;
    EXPECT_TRUE(absl::StrContains(poses.status().message(), sentence))
        << text << " gave " << poses.status();
    EXPECT_TRUE(absl::StrContains(poses.status().message(), "hostile.csv"));
  }
}

TEST(ReadPoseFile, RefusesBinaryAndWhatIsNoFile) {
  std::string bytes;
  for (int i = 0; i < 100000; ++i) bytes += static_cast<char>(i * 7919 >> 3);
  EXPECT_EQ(ReadPoseFile(WriteFile("binary", bytes)).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(ReadPoseFile(::testing::TempDir()).status().code(), absl::StatusCode::kInvalidArgument);
  const absl::Status missing = ReadPoseFile(::testing::TempDir() + "missing.csv").status();
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(absl::StrContains(missing.message(), "missing.csv"));
}

TEST(ReadRelationFile, ReadsTheBenchmarksLines) {
  const auto relations = ReadRelationFile(WriteFile(
      "x.relations", "90.239599 90.719599 0.422330 -0.000750 0.000000 0.1 -0.2 0.017260\n"));
  ASSERT_TRUE(relations.ok()) << relations.status();
  ASSERT_EQ(relations->size(), 1u);
  const Relation& r = (*relations)[0];
  EXPECT_EQ(r.time1_ns, 90'239'599'000);
  EXPECT_EQ(r.time2_ns, 90'719'599'000);
  EXPECT_EQ(r.translation_m.x, 0.42233);
  EXPECT_EQ(r.translation_m.y, -0.00075);
  EXPECT_EQ(r.roll_rad, 0.1);
  EXPECT_EQ(r.pitch_rad, -0.2);
  EXPECT_EQ(r.yaw_rad, 0.01726);
}

TEST(ReadRelationFile, RefusesOtherLines) {
  for (const char* text : {"", "1 2 3\n", "1 2 0 0 0 0 0 nan\n", "1 2 0 0 0 0 0 0 0\n"}) {
    EXPECT_EQ(ReadRelationFile(WriteFile("bad.relations", text)).status().code(),
              absl::StatusCode::kInvalidArgument)
        << text;
  }
}

}  // namespace
}  // namespace soundmap::cli
