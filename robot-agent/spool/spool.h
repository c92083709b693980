#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "recording/writer.h"
#include "sources/frame_source.h"
#include "spool/session_files.h"

namespace soundmap::spool {

struct SpoolOptions {
  std::int64_t max_bytes = 8ll << 30;  // of all sessions
  double max_hours = 24.0;             // that a frame waits
  bool pause_when_full = false;        // else the oldest frames go, and a gap is recorded
  std::int64_t segment_bytes = 4 << 20;
  // What a power failure may take: frames are synced when either is reached.
  std::int64_t sync_bytes = 1 << 20;
  std::chrono::milliseconds sync_interval{200};

  absl::Status Validate() const;
};

// What waits on the disk, for people.
struct SessionSummary {
  std::string session;
  std::string site;
  std::string robot;
  std::int64_t created_ns = 0;
  std::int64_t recorded = 0;  // frames
  std::int64_t waiting = 0;   // of these not known to be durable at the server
  std::int64_t bytes = 0;
  std::int64_t oldest_ns = 0;  // wall clock of the oldest segment; 0: none
  bool ended = false;
  bool delivered = false;
  std::vector<Gap> gaps;
};

// Of a spool that an agent may be using. NotFound: no such folder.
absl::StatusOr<std::vector<SessionSummary>> Inspect(const std::string& folder);

std::string ToJson(const std::vector<SessionSummary>& sessions);

// The robot's own disk, through which all frames go: what was recorded waits here until it is
// durable at the server. One drive at a time is recorded, any number waits. Nothing is delivered
// that is not synced, so that the server never knows a frame that the robot could forget. Thread
// safe.
class Spool {
 public:
  // Creates the folder if it is missing and takes up what a crash has left. FailedPrecondition:
  // another agent uses it.
  static absl::StatusOr<std::unique_ptr<Spool>> Open(const std::string& folder,
                                                     const SpoolOptions& options,
                                                     std::function<std::int64_t()> now_ns);
  // Syncs.
  ~Spool();

  struct Begun {
    std::int64_t position = 0;  // of the frame to be recorded next
    bool ended = false;         // the drive is over; there is nothing to record
  };
  // Begins the drive, or goes on with it if its session is here. The drive before is left as it is.
  absl::StatusOr<Begun> Begin(const v1::CreateSessionRequest& request);
  // Records the next frame. While the spool is full (or its disk) the oldest frames go or, with
  // pause_when_full, this waits; Cancelled after Stop().
  absl::Status Append(sources::SensorFrame frame);
  // The drive is over. Its frames are on the disk when this returns.
  absl::Status End();
  // Ends all waiting, here and in the sources; what was recorded is synced.
  void Stop();

  // Sessions that are not delivered, oldest first.
  std::vector<std::string> Waiting() const;
  absl::StatusOr<v1::CreateSessionRequest> RequestOf(const std::string& session) const;
  // Its frames as the server is to get them: synced ones, as far as there are; lost ones as a gap
  // record. The spool outlives the source.
  std::unique_ptr<sources::FrameSource> Read(const std::string& session);
  // The server has [0, offset) on its disk.
  void Free(const std::string& session, std::int64_t offset);
  // The server has everything in its map.
  absl::Status SetDelivered(const std::string& session);

  // What was found damaged when the spool was opened and is left alone, a sentence each.
  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  friend class SpoolSource;

  struct Session {
    std::string folder;
    SessionRecord record;
    std::vector<Segment> segments;  // in order
    std::int64_t next = 0;          // position
    std::int64_t synced = 0;        // position
  };

  Spool(std::string folder, int lock, const SpoolOptions& options,
        std::function<std::int64_t()> now_ns);
  absl::Status Load();
  absl::StatusOr<Session> LoadSession(const std::string& folder) const;

  // With mutex_ held.
  std::int64_t TotalBytes() const;
  // Whether `bytes` more have room, after the oldest frames have gone if they may.
  bool MakeRoom(std::int64_t bytes);
  bool DropOldestSegment();
  absl::Status StoreRecord(Session& session);
  void WaitForSync(std::unique_lock<std::mutex>& lock);

  // The thread that writes.
  void SyncLoop();
  // What the segment at hand still takes; false if the disk did not take it.
  bool SyncBatch(Session& session, std::unique_lock<std::mutex>& lock);
  absl::Status WriteAndSync(const std::string& folder, std::int64_t first,
                            const std::vector<const sources::SensorFrame*>& frames);
  void CloseSegment(Session& session);

  const std::string folder_;
  const int lock_file_;
  const SpoolOptions options_;
  const std::function<std::int64_t()> now_ns_;

  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  // Guarded by mutex_.
  std::map<std::string, Session> sessions_;
  std::string current_;  // being recorded; empty: none
  // Frames [recent_first_, next) of the current session: those of the open segment and those not
  // written yet.
  std::deque<sources::SensorFrame> recent_;
  std::int64_t recent_first_ = 0;
  std::int64_t unsynced_bytes_ = 0;
  bool sync_now_ = false;
  bool stopping_ = false;
  std::vector<std::string> warnings_;  // constant once open

  // The writing thread's own.
  std::unique_ptr<recording::Writer> writer_;
  std::int64_t segment_frame_bytes_ = 0;
  std::thread syncer_;
};

}  // namespace soundmap::spool
