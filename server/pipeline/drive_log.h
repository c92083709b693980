#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "absl/status/statusor.h"
#include "pipeline/records.h"
#include "pipeline/session.h"
#include "storage/store.h"

namespace soundmap::pipeline {

// The frames of a drive that has arrived in full, from its session log. One thread at a time; the
// store must outlive it.
class DriveLog {
 public:
  class Reader {
   public:
    // The next frame; none where the robot has lost some. DataLoss when the log ends before the
    // drive does, or is damaged.
    absl::StatusOr<std::optional<frames::Frame>> Next();

   private:
    friend class DriveLog;
    Reader(const DriveLog* log, std::unique_ptr<storage::FrameReader> frames)
        : log_(log), frames_(std::move(frames)) {}
    const DriveLog* log_;
    std::unique_ptr<storage::FrameReader> frames_;
  };

  static absl::StatusOr<std::unique_ptr<DriveLog>> Open(const SessionRecord& drive,
                                                        storage::Store* store,
                                                        const Session::FrameDecoder& decode);
  ~DriveLog();

  std::int64_t frame_count() const { return drive_.frame_count; }
  // From frame `offset` on; the log must outlive it.
  absl::StatusOr<Reader> Read(std::int64_t offset = 0) const;

 private:
  DriveLog(const SessionRecord& drive, storage::Store* store, Session::FrameDecoder decode,
           std::shared_ptr<storage::SessionLog> log)
      : drive_(drive), store_(store), decode_(std::move(decode)), log_(std::move(log)) {}

  const SessionRecord drive_;
  storage::Store* const store_;
  const Session::FrameDecoder decode_;
  const std::shared_ptr<storage::SessionLog> log_;
};

}  // namespace soundmap::pipeline
