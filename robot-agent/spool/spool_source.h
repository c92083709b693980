#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "recording/reader.h"
#include "sources/frame_source.h"
#include "spool/spool.h"

namespace soundmap::spool {

// A session of the spool as the server is to get it. Offsets are the server's.
class SpoolSource : public sources::FrameSource {
 public:
  SpoolSource(Spool* spool, std::string session);

  // An offset beyond what is recorded is waited for.
  absl::Status Seek(std::int64_t offset) override;
  absl::StatusOr<std::optional<sources::SensorFrame>> Next() override;
  bool AtEnd() const override;

 private:
  struct Place;
  // What there is at the position; with the spool's lock.
  Place Look() const;
  absl::StatusOr<std::optional<sources::SensorFrame>> ReadSegment(const Place& place);
  absl::StatusOr<std::optional<sources::SensorFrame>> MakeGap(std::int64_t end,
                                                              const std::string& reason);
  sources::SensorFrame GapFrame(const Gap& gap) const;

  Spool* const spool_;
  const std::string session_;
  std::int64_t offset_ = 0;
  std::int64_t position_ = 0;
  std::int64_t last_log_time_ns_ = 0;
  std::unique_ptr<recording::Reader> reader_;
  std::int64_t reader_position_ = 0;  // of the message that it gives next
  std::string reader_path_;
};

}  // namespace soundmap::spool
