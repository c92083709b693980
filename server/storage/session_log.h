#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "recording/message.h"
#include "recording/writer.h"

namespace soundmap::storage {

struct SessionLogOptions {
  std::int64_t segment_bytes = 64 << 20;      // a segment is closed when its frames reach this
  std::int64_t max_pending_bytes = 64 << 20;  // appended and not yet durable; more is refused
  int crc_window_frames = 1 << 16;            // how many frames back PayloadCrc() knows
  std::int64_t min_free_bytes = 64 << 20;     // of the disk; with less nothing is written
  recording::Compression compression = recording::Compression::kLz4;
};

// Frames of a session that were durable when the reader was made, or last extended, in order. One
// thread at a time.
class FrameReader {
 public:
  ~FrameReader();

  // The next frame; none at the end. DataLoss, and it stays so, names the damaged file and what is
  // wrong.
  absl::StatusOr<std::optional<recording::Message>> Next();

  // Of the frame that Next() gives next.
  std::int64_t next_offset() const;

 private:
  friend class SessionLog;
  struct State;
  explicit FrameReader(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// The frames that a session has sent: MCAP segments in a folder of their own, as FORMAT.md says.
// Offsets count frames, are dense and start at 0. Every method may be called on any thread; Sync()
// does all the writing, Append() never waits for the disk.
class SessionLog {
 public:
  // Opens or creates the log, and recovers it: a tail that a crash has cut is dropped.
  // `known_durable`: frames that are known to have been durable; DataLoss, naming the file, when
  // fewer are there. `on_durable` is called at the end of each Sync() that made frames durable.
  static absl::StatusOr<std::shared_ptr<SessionLog>> Open(
      const std::string& folder, const SessionLogOptions& options = {},
      std::int64_t known_durable = 0, std::function<void(std::int64_t)> on_durable = nullptr);
  ~SessionLog();

  // Takes a frame and returns its offset; topic, schema, log_time_ns and data are kept. Schemas are
  // those that recording::Writer knows. ResourceExhausted: too much is pending, or the disk is
  // full; nothing was taken, try again later. FailedPrecondition: closed.
  absl::StatusOr<std::int64_t> Append(recording::Message frame);

  // Writes what is pending and waits until the disk has it; returns durable(). After an error
  // (ResourceExhausted: the disk is full) the frames stay pending, what was durable stays so,
  // Append() refuses, and the next Sync() tries again in a new segment.
  absl::StatusOr<std::int64_t> Sync();

  // Frames 0 .. received()-1 are taken, 0 .. durable()-1 are synced.
  std::int64_t received() const;
  std::int64_t durable() const;

  // Of the newest frame that was taken; empty while there is none.
  std::string last_topic() const;

  // CRC-32C of the data of a frame; none before the window and from received() on.
  std::optional<std::uint32_t> PayloadCrc(std::int64_t offset) const;

  // Durable frames from `first_offset` on. OutOfRange if it is negative or beyond durable().
  absl::StatusOr<std::unique_ptr<FrameReader>> Read(std::int64_t first_offset) const;
  // What has become durable since belongs to the reader, one of this log, as well: it goes on where
  // it stands, without looking for its place again.
  absl::Status Extend(FrameReader& reader) const;

  // Syncs and closes the segment at hand with its summary. Reading goes on; appending is over.
  absl::Status Close();

  // Appending and syncing are over, what is pending is lost. For a session that is deleted.
  void Abandon();

 private:
  struct State;
  explicit SessionLog(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// What reading a whole log without changing it finds.
struct SessionLogCheck {
  std::int64_t segments = 0;
  std::int64_t frames = 0;
  std::vector<std::string> faults;  // one sentence each, naming the file
  // How segments end that have all their frames and no regular end: a crash may have cut them
  // there.
  std::string cut_tail;
};

// A folder that is not there is a log without frames. An error only where something cannot be read.
absl::StatusOr<SessionLogCheck> CheckSessionLog(const std::string& folder,
                                                std::int64_t known_durable);

}  // namespace soundmap::storage
