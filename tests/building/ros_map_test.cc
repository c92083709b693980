#include "building/ros_map.h"

#include <gtest/gtest.h>

#include <random>

namespace soundmap::building {
namespace {

constexpr const char* kYaml =
    "image: plan.pgm\nresolution: 0.050000\norigin: [-1.5, 2.25, 0.0]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.196\n";

std::string Pgm(int width, int height, const std::string& greys) {
  return "P5\n# CREATOR: map_saver\n" + std::to_string(width) + " " + std::to_string(height) +
         "\n255\n" + greys;
}

TEST(RosMap, ReadsWhatMapSaverWrites) {
  // Two rows of three; the picture's first row is the one with the largest y.
  const auto plan = ParseRosMap(kYaml, Pgm(3, 2, std::string("\x00\xfe\xcd\xfe\xfe\x00", 6)));
  ASSERT_TRUE(plan.ok()) << plan.status();
  EXPECT_EQ(plan->width(), 3);
  EXPECT_EQ(plan->height(), 2);
  EXPECT_EQ(plan->cell_size_m(), 0.05);
  EXPECT_EQ(plan->origin_in_map_m(), Eigen::Vector2d(-1.5, 2.25));
  EXPECT_EQ(plan->at(0, 1), Cell::kOccupied);
  EXPECT_EQ(plan->at(1, 1), Cell::kFree);
  EXPECT_EQ(plan->at(2, 1), Cell::kUnknown);
  EXPECT_EQ(plan->at(0, 0), Cell::kFree);
  EXPECT_EQ(plan->at(2, 0), Cell::kOccupied);
}

TEST(RosMap, NegateTurnsLightIntoOccupied) {
  std::string yaml = kYaml;
  yaml.replace(yaml.find("negate: 0"), 9, "negate: 1");
  const auto plan = ParseRosMap(yaml, Pgm(2, 1, std::string("\x00\xff", 2)));
  ASSERT_TRUE(plan.ok()) << plan.status();
  EXPECT_EQ(plan->at(0, 0), Cell::kFree);
  EXPECT_EQ(plan->at(1, 0), Cell::kOccupied);
}

TEST(RosMap, WhatIsWrittenIsRead) {
  FloorPlan plan(17, 9, 0.08, Eigen::Vector2d(-0.1 * 3, 1.0 / 3.0));
  std::mt19937 random(1);
  for (int row = 0; row < 9; ++row) {
    for (int column = 0; column < 17; ++column)
      plan.at(column, row) = static_cast<Cell>(random() % 3);
  }
  const RosMap map = ToRosMap(plan, "site/plan 1.pgm");
  EXPECT_EQ(RosMapImagePath(map.yaml).value(), "site/plan 1.pgm");
  const auto read = ParseRosMap(map.yaml, map.pgm);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(*read, plan);
}

TEST(RosMap, RefusesDamagedPictures) {
  const std::string greys(6, '\0');
  for (const std::string& pgm :
       {std::string(), std::string("P6\n3 2\n255\n") + greys,
        std::string("P5\n3 2\n65535\n") + greys, std::string("P5\n-3 2\n255\n") + greys,
        std::string("P5\n3 0\n255\n") + greys, std::string("P5\n99999999999 2\n255\n") + greys,
        std::string("P5\n2000000000 2000000000\n255\n"),
        std::string("P5\n3 2\n255\n") + greys.substr(1), std::string("P5\n3 2\n255"),
        std::string("P5 # no end")}) {
    EXPECT_EQ(ParseRosMap(kYaml, pgm).status().code(), absl::StatusCode::kInvalidArgument) << pgm;
  }
}

TEST(RosMap, RefusesDamagedYaml) {
  const std::string pgm = Pgm(1, 1, std::string(1, '\0'));
  const auto with = [](const std::string& from, const std::string& to) {
    std::string yaml = kYaml;
    return yaml.replace(yaml.find(from), from.size(), to);
  };
  ASSERT_TRUE(ParseRosMap(kYaml, pgm).ok());
  for (const std::string& yaml :
       {std::string(), std::string("[1, 2"), std::string("just text"), std::string(5000, '['),
        std::string(70000, ' '), with("resolution: 0.05", "resolution: -0.05"),
        with("resolution: 0.05", "resolution: .nan #"), with("resolution", "resolutions"),
        with("[-1.5, 2.25, 0.0]", "[-1.5, 2.25]"), with("[-1.5, 2.25, 0.0]", "[.inf, 2.25, 0]"),
        with("[-1.5, 2.25, 0.0]", "[-1.5, 2.25, 0.1]"), with("negate: 0", "negate: maybe"),
        with("0.65", "0.1"), with("0.65", "7"), std::string(kYaml) + "mode: raw\n"}) {
    EXPECT_EQ(ParseRosMap(yaml, pgm).status().code(), absl::StatusCode::kInvalidArgument)
        << yaml.substr(0, 200);
  }
}

}  // namespace
}  // namespace soundmap::building
