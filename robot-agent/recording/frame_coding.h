#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "soundmap/v1/coded_frame.pb.h"

namespace soundmap::recording {

struct FrameCoding {
  std::set<v1::Coding> allowed;     // none: every message travels as it is
  double lidar_resolution_m = 0.0;  // on whose multiples the points lie; 0: on none
};

struct CodedFrame {
  v1::Coding coding = v1::CODING_UNSPECIFIED;
  std::string bytes;
};

// How a serialized Foxglove message ("foxglove.RawAudio") travels shortest; uncoded, without
// `bytes`, when no coding saves a twentieth.
CodedFrame CodeFrame(std::string_view schema, std::string_view payload, const FrameCoding& coding);

// The message's bytes, `payload_bytes` of them exactly. InvalidArgument with a sentence that does
// not name the frame. Memory: a few times `payload_bytes`, and a few MB.
absl::StatusOr<std::string> DecodeFrame(v1::Coding coding, std::string_view coded,
                                        std::int64_t payload_bytes);

// A serialized PointCloud with its points on multiples of `resolution_m`, as SnapPoints() does it;
// any other message as it is.
std::string SnapFrame(std::string_view schema, std::string payload, double resolution_m);

}  // namespace soundmap::recording
