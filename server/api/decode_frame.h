#pragma once

#include <string_view>

#include "absl/status/statusor.h"
#include "frames/frames.h"

namespace soundmap::api {

// The frame in a serialized Foxglove message; `schema` is its name, e.g. "foxglove.RawAudio". What
// the sensor calls "no return" (NaN, infinity, zero) is marked or left out as frames.h says.
// InvalidArgument: bytes that are no such message, a stamp outside 1970 .. 2262, audio that does
// not fit the calibration, a point layout that does not fit its stride, more than 2^20 beams or
// 2^22 points.
absl::StatusOr<frames::Frame> DecodeFrame(std::string_view schema, std::string_view payload,
                                          const frames::Calibration& calibration);

}  // namespace soundmap::api
