#pragma once

#include "absl/status/statusor.h"
#include "pipeline/session.h"

namespace soundmap::api {

// What a message of a session is: a frame, by DecodeFrame(), or the record of a gap, a
// foxglove.KeyValuePair of key "gap" whose value is JSON with `frames`, `from_ns`, `to_ns` and
// `reason`. InvalidArgument: neither.
absl::StatusOr<pipeline::Session::Decoded> DecodeMessage(const recording::Message& message,
                                                         const frames::Calibration& calibration);

}  // namespace soundmap::api
