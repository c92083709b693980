#pragma once

#include <optional>
#include <span>

#include "absl/status/status.h"
#include "foxglove/PointCloud.pb.h"
#include "soundmap/v1/coded_frame.pb.h"

// A point cloud's points as columns, losslessly. Points whose axes are whole multiples of a
// resolution travel as a range image: by how far they lie from where the beam before them in their
// ring, turned on by a step, would have ended.
namespace soundmap::recording {

// Puts x, y and z of every point on whole multiples of `resolution_m`: each moves by half of it at
// most. A point with an axis that is not finite becomes (0, 0, 0): no return, either way. A cloud
// with a point farther than 2^22 resolutions, or without x, y, z as floats, stays as it is; false.
bool SnapPoints(double resolution_m, foxglove::PointCloud& cloud);

// `head` and `tail` are left to the caller. Points on multiples of `resolution_m` become a range
// image; 0: none does. None: no whole number of points, or a stride beyond 256.
std::optional<v1::PackedPoints> PackPoints(const foxglove::PointCloud& cloud, double resolution_m);

// Fills `data`, which is what the points must give, exactly. InvalidArgument with half a sentence
// on what is wrong. Memory: some 20 bytes a point beyond `data`.
absl::Status UnpackPoints(const v1::PackedPoints& packed, std::span<char> data);

}  // namespace soundmap::recording
