#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/strand.hpp>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"
#include "frames/frames.h"
#include "pipeline/band.h"
#include "pipeline/listening.h"
#include "pipeline/meters.h"
#include "pipeline/profile.h"
#include "pipeline/records.h"
#include "pipeline/region.h"
#include "storage/store.h"

namespace soundmap::pipeline {

// How many frames of a session were received, are synced to disk, have had their effect.
struct Watermarks {
  std::int64_t received = 0;
  std::int64_t durable = 0;
  std::int64_t processed = 0;
  bool complete = false;  // the robot sent all, and all is processed
};

// One drive of one robot: its frames enter the log, and once durable the pipeline, in order, on a
// strand of its own. The end of the drive is a message in the log like any other, so that the whole
// session is a function of the log. Thread safe.
class Session : public std::enable_shared_from_this<Session> {
 public:
  using Decoded = std::variant<frames::Frame, Gap>;
  using FrameDecoder =
      std::function<absl::StatusOr<Decoded>(const recording::Message&, const frames::Calibration&)>;
  // The site's parts that a session works with; all outlive it.
  struct Site {
    storage::Store* store = nullptr;
    Region* region = nullptr;
    const Profile* profile = nullptr;
    const std::vector<Band>* bands = nullptr;
    std::shared_ptr<const PreparedBuilding> building;  // null while mapping
    FrameDecoder decode;
    boost::asio::any_io_executor executor;
    Meters* meters = nullptr;  // null: nothing is counted
  };

  // Opens the log and brings the pipeline to where it was: the last state snapshot, then the frames
  // behind it that had their effect, which does not count again: ten seconds of driving and a batch
  // at most, however long the drive is.
  static absl::StatusOr<std::shared_ptr<Session>> Open(SessionRecord record, Site site);

  SessionRecord record() const;
  const std::string& robot() const { return robot_; }
  Watermarks watermarks() const;
  // The newest estimate of where the robot is; none while mapping or before the first correction.
  std::optional<localization::PoseEstimate> newest_pose() const;
  // By the newest frames that had their effect; none while the robot does not know where it is.
  std::optional<localization::OdometryFrame> odometry_frame() const;
  // Payload bytes that were received and are not yet on disk.
  std::int64_t bytes_in_flight() const;
  // An unrecoverable fault (damage to the log); OK otherwise.
  absl::Status fault() const;

  // Makes `epoch` the session's newest stream; `wake` is called, possibly under a lock of the
  // session, whenever a watermark, the fault or the epoch changes. Returns the offset to resume
  // from.
  std::int64_t Attach(std::int64_t epoch, std::function<void()> wake);
  void Detach(std::int64_t epoch);
  // OK while `epoch` is the newest stream; Aborted once another has attached; the session's fault;
  // ResourceExhausted while the disk is full.
  absl::Status StreamStatus(std::int64_t epoch) const;
  bool streaming() const;

  enum class Taken { kYes, kDuplicate, kGap };
  // A frame of the stream of `epoch`. kGap: offsets before this one are missing, nothing was taken.
  // Aborted: a newer epoch has attached. DataLoss: the offset was taken before with other bytes.
  // InvalidArgument: not a frame. ResourceExhausted: the disk is full.
  absl::StatusOr<Taken> Receive(std::int64_t epoch, std::int64_t offset,
                                recording::Message message);

  // The drive has `frame_count` frames. FailedPrecondition: it has others.
  absl::Status Finish(std::int64_t epoch, std::int64_t frame_count);

  // The newest is known at once; it is stored when a clock has jumped or 10 s are over, but not
  // twice in a second. Nothing changes once the session is complete.
  void TakeClockOffset(const ClockOffset& offset);

  // The log's frames before `durable` are on disk; or why they are not.
  void OnDurable(const absl::StatusOr<std::int64_t>& durable);

  // Raises the epoch and returns it; the record is stored.
  absl::StatusOr<std::int64_t> NextEpoch();

  // Goes on with the frames that are durable and had no effect yet. Once, after Open().
  void Resume();

  // Removes the frames of a listening drive that was begun before `begun_before_ns` and is complete
  // from the disk. Whether there was something to remove. FailedPrecondition: something reads them.
  absl::StatusOr<bool> DropFrames(std::int64_t begun_before_ns);

  // Begins no further batch; what is durable is processed after the next Open(). Never waits, so
  // that of many sessions none waits for the work of those that are not told yet.
  void AskToStop();
  // The same, and returns when the strand is idle.
  void Stop();

 private:
  struct End {};
  struct Item {
    std::variant<frames::Frame, Gap, End> content;
    std::int64_t log_time_ns = 0;
    std::int64_t payload_bytes = 0;
  };
  struct Pending {
    std::int64_t payload_bytes = 0;
    std::chrono::steady_clock::time_point received_at;
  };

  Session(SessionRecord record, Site site);
  absl::Status Recover();
  // Computes again what had its effect.
  absl::Status Replay();
  absl::Status ReadNewestPose();
  absl::StatusOr<Item> Decode(const recording::Message& message) const;
  storage::SessionId id() const { return {commit_.site, commit_.session}; }

  // With mutex_ held.
  absl::Status CheckStream(std::int64_t epoch) const;
  void AddInFlight(std::int64_t bytes);
  void AddBacklog(std::int64_t frames);
  void Queue(Item item);  // the frame received_
  void Wake();

  // On the strand, or before it runs.
  void Process();
  // Puts what is durable and not in the queue into the batch, as much as a batch may have.
  absl::Status ReadBatch(std::int64_t end);
  bool IsBatchFull() const;
  void Fail(const absl::Status& status);
  void Apply(Item item);
  // Whether frames wait to be heard that can be heard now.
  bool IsBehind() const;
  // Reads some of them from the log and hears them.
  absl::Status CatchUp();
  // The next item to hear.
  void Hear(Item item, Listening::Output& output);
  void Keep(const Gap& gap);
  void TakeScans(std::int64_t offset, std::vector<Listening::Scan> scans);
  absl::Status StoreRecord();
  absl::Status Commit();
  absl::Status Complete();
  void CommitAndGoOn();

  const Site site_;
  const std::string robot_;
  boost::asio::strand<boost::asio::any_io_executor> strand_;

  std::mutex record_mutex_;   // held while the record is stored; taken before mutex_
  mutable std::mutex mutex_;  // never held while waiting for the disk
  SessionRecord record_;      // guarded by mutex_, but for its constant parts
  std::shared_ptr<storage::SessionLog> log_;  // guarded by mutex_; null once complete
  // Guarded by mutex_. The newest frames, up to received_-1, a bounded number of bytes: what the
  // map is further behind is read from the log. The counts include the end of the drive.
  std::deque<Item> queue_;
  std::int64_t queue_bytes_ = 0;
  std::deque<Pending> pending_;  // frames durable_ .. received_-1, bounded by the stream's credit
  std::int64_t received_ = 0;
  std::int64_t durable_ = 0;
  std::int64_t processed_ = 0;
  std::int64_t bytes_in_flight_ = 0;
  std::int64_t backlog_frames_ = 0;  // durable and not processed, until Stop()
  std::optional<localization::PoseEstimate> newest_pose_;
  std::optional<localization::OdometryFrame> odometry_frame_;
  std::optional<ClockOffset> stored_offset_;  // the newest that was to be stored
  bool ended_ = false;                        // the log has the end of the drive
  absl::Status fault_;                        // for good
  absl::Status storage_trouble_;              // a full disk: the stream ends, and may come again
  std::int64_t stream_epoch_ = 0;             // 0: none is attached
  std::function<void()> wake_;
  bool scheduled_ = false;
  bool stopping_ = false;

  // Strand-owned.
  StageClock clock_;
  std::unique_ptr<Listening> listening_;  // null while mapping
  std::deque<Item> batch_;                // durable, to be processed next: frames from next_ on
  std::int64_t batch_left_bytes_ = 0;     // of the frames in it
  std::unique_ptr<storage::FrameReader> unread_;  // behind the batch, while the queue begins later
  std::int64_t heard_ = 0;  // the next frame to hear: what a lost robot heard waits
  std::unique_ptr<storage::FrameReader> unheard_;  // at the frame heard_, while catching up
  // Poses and evidence of frames before these were stored before the server last started.
  std::int64_t stored_poses_ = 0;
  std::int64_t stored_evidence_ = 0;
  storage::Commit commit_;  // what the frames since the last commit led to
  std::int64_t next_ = 0;   // the next frame to process
  frames::TimeNs batch_first_ns_ = 0;
  frames::TimeNs batch_last_ns_ = 0;
  frames::TimeNs heard_ns_ = 0;  // of the newest frame that was heard
  // batch_last_ns_ and heard_ns_ at the last state snapshot.
  frames::TimeNs snapshot_ns_ = 0;
  frames::TimeNs snapshot_heard_ns_ = 0;
  bool finished_ = false;
  bool record_changed_ = false;  // by the strand, and is not stored
  boost::asio::steady_timer retry_;
};

}  // namespace soundmap::pipeline
