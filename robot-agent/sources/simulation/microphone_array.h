#pragma once

#include <Eigen/Core>
#include <optional>
#include <string_view>
#include <vector>

namespace soundmap::simulation {

// Named arrays, in their own frame (`mic_array`), origin at the middle of the lowest ring or of the
// body.
enum class ArrayShape {
  kRing,      // one horizontal ring
  kTwoRings,  // two horizontal rings, the upper one turned by half a step
  kDome,      // rings of 8, 5 and 3 on a half sphere, at elevations of 0, 35 and 70 degrees: 16
              // microphones
  kSphere,    // spread evenly over a sphere
  kCube,      // the eight corners of a cube that fits into the sphere of that radius
};

std::optional<ArrayShape> ArrayShapeFromName(std::string_view name);

// `count` holds for kRing, kTwoRings (half of it a ring) and kSphere; `height_m` is the distance of
// the two rings.
std::vector<Eigen::Vector3d> MakeArray(ArrayShape shape, int count, double radius_m,
                                       double height_m);

}  // namespace soundmap::simulation
