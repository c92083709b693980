#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "acoustics/likelihood_scan.h"
#include "ray_casting/ray_caster.h"

namespace soundmap::ray_casting {

// Marks the peaks of one audio scan that are heard by way of a surface, and says how the surface
// lies where each peak's direction ends, if it is flat. The LIDAR shows the surface
// at which a peak's direction ends; where the mirror image in it of what a stronger peak hears
// stands in that direction, too, the peak is the reflection of that one. Such an image may be
// reflected once more. (A source on the surface itself is its own image and is none.)
//
// `peaks`: the strongest first, directions in mic_array. An array in a plane cannot tell a
// direction from its mirror image in that plane, whose normal it gives: each peak then stands for
// both.
void MarkReflections(const LidarView& lidar, const Eigen::Isometry3d& base_from_array,
                     const std::optional<Eigen::Vector3d>& array_normal,
                     std::vector<acoustics::Peak>& peaks);

}  // namespace soundmap::ray_casting
