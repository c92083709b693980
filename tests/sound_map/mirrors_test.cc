#include "sound_map/mirrors.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace soundmap::sound_map {
namespace {

constexpr double kWithin_rad = 8.0 * std::numbers::pi / 180.0;

double AngleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// Places around arrays in any plane, half of them near the image of another one, against the image
// of each point and the angle between the rays.
TEST(Mirrors, ArePlacesInMirroredDirections) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  const auto vector = [&] {
    return Eigen::Vector3d(normal(random), normal(random), normal(random));
  };
  int mirrored = 0;
  int apart = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const ArrayPlane plane{vector(), vector().normalized()};
    const auto image = [&plane](const Eigen::Vector3d& place) -> Eigen::Vector3d {
      const double height_m = (place - plane.origin_in_map_m).dot(plane.normal_in_map);
      return place - 2.0 * height_m * plane.normal_in_map;
    };
    std::vector<Mirrors> counted(6);
    std::vector<HeardPlace> heard;
    for (std::size_t i = 0; i < counted.size(); ++i) {
      Eigen::Vector3d place = plane.origin_in_map_m + 3.0 * vector();
      if (i % 2 == 1) {
        // As far away as it is loud: the distance does not count, the direction does.
        const Eigen::Vector3d beyond = image(heard.back().place_in_map_m) - plane.origin_in_map_m;
        place = plane.origin_in_map_m + (0.5 + i) * (beyond + 0.1 * beyond.norm() * vector());
      }
      heard.push_back({100 + i, place, &counted[i]});
    }
    CountMirrors(plane, heard);
    for (std::size_t a = 0; a < heard.size(); ++a) {
      EXPECT_EQ(counted[a].scans, 1.0);
      for (std::size_t b = 0; b < heard.size(); ++b) {
        if (a == b) continue;
        // The direction of the first of them says whether they are too near the plane.
        const HeardPlace& first = heard[std::min(a, b)];
        const HeardPlace& second = heard[std::max(a, b)];
        const Eigen::Vector3d ray = first.place_in_map_m - plane.origin_in_map_m;
        const Eigen::Vector3d mirrored_ray = image(first.place_in_map_m) - plane.origin_in_map_m;
        const double off_rad =
            AngleBetween(mirrored_ray, second.place_in_map_m - plane.origin_in_map_m);
        const bool expected =
            off_rad <= kWithin_rad && AngleBetween(ray, mirrored_ray) >= kWithin_rad;
        EXPECT_EQ(counted[a].with.count(heard[b].id), expected ? 1u : 0u)
            << trial << " " << a << " " << b << " " << off_rad;
        ++(expected ? mirrored : apart);
      }
    }
  }
  EXPECT_GT(mirrored, 300);
  EXPECT_GT(apart, 300);
}

// A place 0.7 m above an array and its image, and one that is heard beside them.
TEST(Mirrors, HalfOfTheScansAndSixteenTell) {
  const ArrayPlane plane{{0.0, 0.0, 1.2}, Eigen::Vector3d::UnitZ()};
  const Eigen::Vector3d upper(3.0, 1.0, 1.9);
  const Eigen::Vector3d lower(3.0, 1.0, 0.5);
  const auto told = [&](int together, int upper_alone) {
    Mirrors of_upper;
    Mirrors of_lower;
    for (int scan = 0; scan < together + upper_alone; ++scan) {
      std::vector<HeardPlace> heard = {{1, upper, &of_upper}};
      if (scan < together) heard.push_back({2, lower, &of_lower});
      CountMirrors(plane, heard);
    }
    EXPECT_FALSE(of_upper.Has(1));
    EXPECT_FALSE(of_upper.Has(3));
    return std::pair(of_upper.Has(2), of_lower.Has(1));
  };
  EXPECT_EQ(told(15, 0), std::pair(false, false));
  EXPECT_EQ(told(16, 0), std::pair(true, true));
  EXPECT_EQ(told(16, 16), std::pair(true, true));
  EXPECT_EQ(told(16, 17), std::pair(false, true));
  // Long ago counts less; the share stays.
  EXPECT_EQ(told(4000, 3000), std::pair(false, true));
}

// An array in space, or one whose plane lies elsewhere, tells a place from its image.
TEST(Mirrors, WhatAnotherArrayHearsSpeaksAgainstAnImage) {
  const ArrayPlane plane{{0.0, 0.0, 1.2}, Eigen::Vector3d::UnitZ()};
  const ArrayPlane higher{{0.0, 0.0, 1.8}, Eigen::Vector3d::UnitZ()};
  for (const std::optional<ArrayPlane>& other : {std::optional<ArrayPlane>(), {higher}}) {
    Mirrors upper;
    Mirrors lower;
    const std::vector<HeardPlace> both = {{1, {3.0, 1.0, 1.9}, &upper},
                                          {2, {3.0, 1.0, 0.5}, &lower}};
    for (int scan = 0; scan < 40; ++scan) CountMirrors(plane, both);
    for (int scan = 0; scan < 40; ++scan) CountMirrors(other, {both[0]});
    EXPECT_TRUE(upper.Has(2));
    CountMirrors(other, {both[0]});
    EXPECT_FALSE(upper.Has(2));
    EXPECT_TRUE(lower.Has(1));
    for (int scan = 0; scan < 41; ++scan) CountMirrors(other, both);
    EXPECT_FALSE(lower.Has(1));
  }
}

TEST(Mirrors, FollowNames) {
  Mirrors mirrors;
  mirrors.with = {{1, 20.0}, {2, 30.0}, {3, 5.0}};
  using With = std::map<std::uint64_t, double>;
  mirrors.Swap(1, 2);
  EXPECT_EQ(mirrors.with, With({{1, 30.0}, {2, 20.0}, {3, 5.0}}));
  mirrors.Swap(9, 3);
  EXPECT_EQ(mirrors.with, With({{1, 30.0}, {2, 20.0}, {9, 5.0}}));
  mirrors.Swap(7, 8);
  mirrors.Merge(7, 1);
  EXPECT_EQ(mirrors.with, With({{1, 30.0}, {2, 20.0}, {9, 5.0}}));
  mirrors.Merge(1, 2);
  EXPECT_EQ(mirrors.with, With({{2, 30.0}, {9, 5.0}}));
  mirrors.Merge(9, 4);
  EXPECT_EQ(mirrors.with, With({{2, 30.0}, {4, 5.0}}));
  mirrors.Merge(4, 2);
  EXPECT_EQ(mirrors.with, With({{2, 30.0}}));
}

TEST(Mirrors, OldScansAreForgottenAndTheShareStays) {
  const ArrayPlane plane{{0.0, 0.0, 1.2}, Eigen::Vector3d::UnitZ()};
  Mirrors upper;
  Mirrors lower;
  for (int scan = 0; scan < 10'000; ++scan) {
    std::vector<HeardPlace> heard = {{1, {3.0, 1.0, 1.9}, &upper}};
    if (scan % 4 != 0) heard.push_back({2, {3.0, 1.0, 0.5}, &lower});
    CountMirrors(plane, heard);
    ASSERT_LE(upper.scans, 1024.0);
    if (scan > 100) {
      ASSERT_NEAR(upper.with[2] / upper.scans, 0.75, 0.02);
    }
  }
  EXPECT_EQ(lower.with[1], lower.scans);
}

}  // namespace
}  // namespace soundmap::sound_map
