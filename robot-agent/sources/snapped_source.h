#pragma once

#include <utility>

#include "recording/frame_coding.h"
#include "sources/frame_source.h"
#include "sources/sensor_format.h"

namespace soundmap::sources {

// Another source with its LIDAR points on multiples of `resolution_m`, so that they travel as a
// range image; 0: as they are.
class SnappedSource : public FrameSource {
 public:
  SnappedSource(FrameSource* source, double resolution_m)
      : source_(source), resolution_m_(resolution_m) {}

  absl::Status Seek(std::int64_t offset) override { return source_->Seek(offset); }
  absl::StatusOr<std::optional<SensorFrame>> Next() override {
    auto frame = source_->Next();
    if (frame.ok() && *frame && resolution_m_ > 0.0) {
      SensorFrame& at_hand = **frame;
      at_hand.payload = recording::SnapFrame(FormatOf(at_hand.sensor).schema,
                                             std::move(at_hand.payload), resolution_m_);
    }
    return frame;
  }

 private:
  FrameSource* const source_;
  const double resolution_m_;
};

}  // namespace soundmap::sources
