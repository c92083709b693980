#include "ray_casting/reflections.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "geometry/angles.h"

namespace soundmap::ray_casting {
namespace {

// A room of 8 x 6 x 3 m with the array somewhere in it; LIDAR points with noise on all its walls.
const Eigen::Vector3d kMin(-3.0, -2.5, -1.2), kMax(5.0, 3.5, 1.8);

class ReflectionsTest : public ::testing::Test {
 protected:
  ReflectionsTest() {
    std::mt19937 random(3);
    std::normal_distribution<float> noise(0.0f, 0.015f);
    for (int axis = 0; axis < 3; ++axis) {
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      for (double a = kMin[u]; a <= kMax[u]; a += 0.1) {
        for (double b = kMin[v]; b <= kMax[v]; b += 0.1) {
          for (const double wall : {kMin[axis], kMax[axis]}) {
            Eigen::Vector3f point;
            point[axis] = static_cast<float>(wall) + noise(random);
            point[u] = static_cast<float>(a);
            point[v] = static_cast<float>(b);
            points_.push_back(point);
          }
        }
      }
    }
    base_from_array_ = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized());
  }

  void Hear(const Eigen::Vector3d& place_in_base) {
    const Eigen::Vector3d in_array = base_from_array_.inverse() * place_in_base;
    peaks_.push_back({in_array.normalized(), 20.0 - static_cast<double>(peaks_.size())});
  }
  std::vector<bool> Marked() {
    LidarView view;
    view.point_in_base = points_;
    MarkReflections(view, base_from_array_, array_normal_, peaks_);
    std::vector<bool> marked;
    for (const acoustics::Peak& peak : peaks_) marked.push_back(peak.reflection);
    return marked;
  }

  std::vector<Eigen::Vector3f> points_;
  Eigen::Isometry3d base_from_array_ = Eigen::Isometry3d::Identity();
  std::optional<Eigen::Vector3d> array_normal_;
  std::vector<acoustics::Peak> peaks_;
};

// The mirror image in a wall of the axis.
Eigen::Vector3d Image(Eigen::Vector3d point, int axis, double wall) {
  point[axis] = 2.0 * wall - point[axis];
  return point;
}

TEST_F(ReflectionsTest, FirstAndSecondImagesOfAStrongerPeakAreMarkedAndOtherSourcesAreNot) {
  const Eigen::Vector3d source(kMax.x(), 1.0, 0.5);
  const Eigen::Vector3d in_floor = Image(source, 2, kMin.z());
  const Eigen::Vector3d in_side = Image(source, 1, kMax.y());
  Hear(source);
  Hear(in_floor);
  Hear({kMin.x(), -1.0, 0.7});  // another source
  Hear(in_side);
  Hear(Image(in_side, 0, kMin.x()));  // by way of two walls
  Hear({1.0, 2.0, kMax.z()});         // on the ceiling
  EXPECT_EQ(Marked(), (std::vector<bool>{false, true, false, true, true, false}));
}

// Whichever points of a wall stand together in the scan, or in its last, short group.
TEST_F(ReflectionsTest, TheOrderOfThePointsDoesNotMatter) {
  const Eigen::Vector3d source(kMax.x(), 1.0, 0.5);
  Hear(source);
  Hear(Image(source, 2, kMin.z()));
  Hear(Image(source, 1, kMax.y()));
  Hear({1.0, 2.0, kMax.z()});
  const std::vector<bool> expected = {false, true, true, false};
  ASSERT_EQ(Marked(), expected);
  std::mt19937 random(6);
  for (int order = 0; order < 20; ++order) {
    std::shuffle(points_.begin(), points_.end(), random);
    EXPECT_EQ(Marked(), expected) << "order " << order;
  }
  // The place where the floor reflects at the end, and at the beginning.
  const Eigen::Vector3d image = Image(source, 2, kMin.z());
  const Eigen::Vector3f mirror = (kMin.z() / image.z() * image).cast<float>();
  std::partition(points_.begin(), points_.end(),
                 [&](const Eigen::Vector3f& point) { return (point - mirror).norm() > 0.4f; });
  EXPECT_EQ(Marked(), expected);
  std::reverse(points_.begin(), points_.end());
  EXPECT_EQ(Marked(), expected);
}

// Of the wall that a peak's direction meets, towards the array.
TEST_F(ReflectionsTest, SaysHowTheSurfaceLies) {
  Hear({kMax.x(), 1.0, 0.5});
  (void)Marked();
  ASSERT_EQ(peaks_.size(), 1u);  // one is enough
  const auto normal_in_base = [this](std::size_t peak) -> Eigen::Vector3d {
    return base_from_array_ * peaks_[peak].surface_normal_in_array;
  };
  EXPECT_LT((normal_in_base(0) + Eigen::Vector3d::UnitX()).norm(), 0.05);
  Hear({1.0, kMin.y(), 0.2});
  Hear({1.0, 2.0, kMax.z()});
  (void)Marked();
  EXPECT_LT((normal_in_base(1) - Eigen::Vector3d::UnitY()).norm(), 0.05);
  EXPECT_LT((normal_in_base(2) + Eigen::Vector3d::UnitZ()).norm(), 0.05);
  // Where the LIDAR sees nothing, nothing is known.
  std::erase_if(points_, [](const Eigen::Vector3f& p) { return p.x() > kMax.x() - 0.3; });
  peaks_[0].surface_normal_in_array.setZero();
  (void)Marked();
  EXPECT_EQ(normal_in_base(0), Eigen::Vector3d::Zero());
}

TEST_F(ReflectionsTest, AStrongerPeakIsNoReflectionOfAWeakerOne) {
  const Eigen::Vector3d source(kMax.x(), 1.0, 0.5);
  Hear(Image(source, 2, kMin.z()));
  Hear(source);
  EXPECT_FALSE(Marked()[0]);
}

TEST_F(ReflectionsTest, ASourceBesideAnotherOnOneWallIsNone) {
  Hear({kMax.x(), 1.0, 0.5});
  Hear({kMax.x(), -0.5, 0.2});
  EXPECT_EQ(Marked(), (std::vector<bool>{false, false}));
}

// What is not flat, such as a shelf, is no mirror.
TEST_F(ReflectionsTest, OnlyFlatSurfacesReflect) {
  const Eigen::Vector3d source(kMax.x(), 1.0, 0.5);
  std::mt19937 random(4);
  std::uniform_real_distribution<float> deep(0.0f, 0.3f);
  for (Eigen::Vector3f& point : points_) {
    if (point.z() < kMin.z() + 0.1f) point.z() += deep(random);
  }
  Hear(source);
  Hear(Image(source, 2, kMin.z()));
  EXPECT_EQ(Marked(), (std::vector<bool>{false, false}));
}

// The peak of the reflection may be given on the other side of the array's plane.
TEST_F(ReflectionsTest, AnArrayInAPlaneHearsBothSides) {
  const Eigen::Vector3d normal_in_base(0.0, 0.1, 1.0);
  array_normal_ = base_from_array_.inverse() * normal_in_base.normalized();
  const Eigen::Vector3d source(kMax.x(), 1.0, 0.5);
  const Eigen::Vector3d image = Image(source, 1, kMin.y());
  Hear(source);
  Hear(image - 2.0 * normal_in_base.dot(image) / normal_in_base.squaredNorm() * normal_in_base);
  EXPECT_EQ(Marked(), (std::vector<bool>{false, true}));
}

// Far away a LIDAR sees the floor in rings that are further apart than points are along them.
TEST_F(ReflectionsTest, AFloorSeenInRingsIsAMirror) {
  const double height_m = -kMin.z();
  std::erase_if(points_, [](const Eigen::Vector3f& p) { return p.z() < kMin.z() + 0.1; });
  std::mt19937 random(5);
  std::normal_distribution<float> noise(0.0f, 0.015f);
  for (double down_deg = 24.0; down_deg > 13.0; down_deg -= 2.75) {
    const double far_m = height_m / std::tan(geometry::RadFromDeg(down_deg));
    for (double azimuth_deg = 0.0; azimuth_deg < 360.0; azimuth_deg += 1.0) {
      const double azimuth_rad = geometry::RadFromDeg(azimuth_deg);
      const Eigen::Vector3d point(far_m * std::cos(azimuth_rad), far_m * std::sin(azimuth_rad),
                                  kMin.z());
      if ((point.array() < kMin.array()).any() || (point.array() > kMax.array()).any()) continue;
      points_.push_back(point.cast<float>() + Eigen::Vector3f(0, 0, noise(random)));
    }
  }
  const Eigen::Vector3d source(kMax.x(), 1.0, -0.5);
  Hear(source);
  Hear(Image(source, 2, kMin.z()));  // reflected 3.2 m away, between two rings
  Hear({3.2, -2.0, kMin.z()});       // on the floor
  EXPECT_EQ(Marked(), (std::vector<bool>{false, true, false}));
}

// How far a direction is from its plane, such an array hardly tells where that is little.
TEST_F(ReflectionsTest, AnArrayInAPlaneHearsWhereAnImageIsAlongItAlone) {
  const Eigen::Vector3d source(kMax.x(), 1.0, 0.0);
  const Eigen::Vector3d in_side = Image(source, 1, kMax.y());
  const Eigen::Vector3d heard = in_side + 0.2 * in_side.norm() * Eigen::Vector3d::UnitZ();
  Hear(source);
  Hear(heard);
  EXPECT_EQ(Marked(), (std::vector<bool>{false, false}));
  array_normal_ = base_from_array_.inverse() * Eigen::Vector3d::UnitZ();
  EXPECT_EQ(Marked(), (std::vector<bool>{false, true}));
}

TEST_F(ReflectionsTest, WithoutAViewNothingIsMarked) {
  points_.clear();
  Hear({kMax.x(), 1.0, 0.5});
  Hear({kMax.x(), 1.0, -3.0});
  EXPECT_EQ(Marked(), (std::vector<bool>{false, false}));
}

}  // namespace
}  // namespace soundmap::ray_casting
