#include "pipeline/session.h"

#include <algorithm>
#include <boost/asio/post.hpp>
#include <chrono>
#include <future>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "pipeline/archive.h"
#include "storage/crc32c.h"

namespace soundmap::pipeline {
namespace {

// What one visit to the strand processes at most before another robot may have the thread.
constexpr int kBatchFrames = 64;
constexpr std::int64_t kBatchBytes = 2 << 20;
// Payload that waits in memory for the map; a robot sends some tenths of it in the time that it
// takes to sync.
constexpr std::int64_t kQueueBytes = 2 << 20;

constexpr frames::TimeNs kSnapshotInterval_ns = 10'000'000'000;
constexpr std::int64_t kOffsetInterval_ns = 10'000'000'000;
constexpr std::int64_t kMinOffsetInterval_ns = 1'000'000'000;
constexpr std::chrono::milliseconds kCommitRetry(500);
// Of a session; what is lost later counts for the last one.
constexpr std::size_t kMaxGaps = 1000;

// The end of a drive in the session log: a foxglove.KeyValuePair whose key is "end".
constexpr char kEndTopic[] = "/session/end";
constexpr char kEndSchema[] = "foxglove.KeyValuePair";
constexpr char kEndPayload[] =
    "\x0a\x03"
    "end";

}  // namespace

Session::Session(SessionRecord record, Site site)
    : site_(std::move(site)),
      robot_(record.robot),
      strand_(boost::asio::make_strand(site_.executor)),
      record_(std::move(record)),
      clock_(site_.meters != nullptr ? &site_.meters->stages : nullptr),
      retry_(strand_) {
  commit_.site = record_.site;
  commit_.session = record_.session;
}

absl::StatusOr<std::shared_ptr<Session>> Session::Open(SessionRecord record, Site site) {
  std::shared_ptr<Session> session(new Session(std::move(record), std::move(site)));
  const absl::Status recovered = session->Recover();
  if (recovered.code() == absl::StatusCode::kDataLoss) {
    // The other sessions of the site go on without this one.
    session->fault_ = recovered;
  } else if (!recovered.ok()) {
    return recovered;
  }
  return session;
}

absl::Status Session::Recover() {
  if (record_.complete) {
    received_ = durable_ = processed_ = next_ = record_.frame_count + 1;
    ended_ = true;
    return ReadNewestPose();
  }
  auto log = site_.store->OpenSession(id());
  if (!log.ok()) return log.status();
  log_ = *std::move(log);
  received_ = durable_ = log_->durable();
  ended_ = log_->last_topic() == kEndTopic;
  const auto processed = site_.store->ProcessedOffset(id());
  if (!processed.ok()) return processed.status();
  processed_ = stored_poses_ = *processed;
  AddBacklog(durable_ - processed_);
  const auto heard = site_.store->HeardOffset(id());
  if (!heard.ok()) return heard.status();
  stored_evidence_ = *heard;

  if (record_.purpose == Purpose::kListening) {
    auto listening =
        Listening::Create(*site_.profile, *site_.bands, record_.calibration, site_.building,
                          record_.initial_pose, storage::Crc32c(record_.session), &clock_);
    if (!listening.ok()) return listening.status();
    listening_ = *std::move(listening);
    const auto state = site_.store->LatestState(id());
    if (!state.ok()) return state.status();
    if (state->has_value()) {
      const absl::Status restored = listening_->RestoreState((*state)->state);
      // The state of another version is made again from the start of the log.
      if (restored.ok()) {
        next_ = (*state)->offset;
        heard_ = listening_->heard();
        odometry_frame_ = listening_->odometry_frame();
      } else if (!absl::IsDataLoss(restored)) {
        return restored;
      }
    }
  }
  if (durable_ == 0) return absl::OkStatus();

  auto first = log_->Read(0);
  if (!first.ok()) return first.status();
  const auto first_message = (*first)->Next();
  if (!first_message.ok()) return first_message.status();
  if (first_message->has_value()) record_.first_frame_ns = (*first_message)->log_time_ns;

  const absl::Status replayed = Replay();
  if (!replayed.ok()) return replayed;
  return finished_ ? Complete() : absl::OkStatus();
}

absl::Status Session::Replay() {
  auto reader = log_->Read(next_);
  if (!reader.ok()) return reader.status();
  const std::int64_t first = next_;
  while (next_ < stored_poses_ || (heard_ < stored_evidence_ && IsBehind())) {
    if (IsBehind()) {
      const absl::Status caught_up = CatchUp();
      if (!caught_up.ok()) return caught_up;
      continue;
    }
    auto message = (*reader)->Next();
    if (!message.ok()) return message.status();
    if (!message->has_value()) return absl::DataLossError("the session log ends early");
    auto item = Decode(**message);
    if (!item.ok()) return item.status();
    Apply(*std::move(item));
  }
  if (next_ > first) {
    if (site_.meters != nullptr) site_.meters->replayed_frames += next_ - first;
    return Commit();
  }
  return absl::OkStatus();
}

void Session::Resume() {
  std::lock_guard lock(mutex_);
  if (scheduled_ || stopping_ || !fault_.ok() || record_.complete) return;
  scheduled_ = true;
  boost::asio::post(strand_, [self = shared_from_this()] { self->Process(); });
}

absl::Status Session::ReadNewestPose() {
  // The path of a drive is some thousands of poses; the newest lies at the end of it.
  const frames::TimeNs from_ns = record_.last_frame_ns - frames::NsFromSeconds(60.0);
  return site_.store->ReadTrajectory(id(), from_ns, std::numeric_limits<frames::TimeNs>::max(),
                                     [this](const storage::TrajectoryEntry& entry) {
                                       auto pose = DecodePose(entry.pose);
                                       if (!pose.ok()) return pose.status();
                                       newest_pose_ = *std::move(pose);
                                       return absl::OkStatus();
                                     });
}

absl::StatusOr<Session::Item> Session::Decode(const recording::Message& message) const {
  Item item;
  item.log_time_ns = message.log_time_ns;
  item.payload_bytes = static_cast<std::int64_t>(message.data.size());
  if (message.topic == kEndTopic) {
    item.content = End{};
    return item;
  }
  auto decoded = site_.decode(message, record_.calibration);
  if (!decoded.ok()) return decoded.status();
  std::visit([&item](auto&& content) { item.content = std::move(content); }, *decoded);
  return item;
}

SessionRecord Session::record() const {
  std::lock_guard lock(mutex_);
  return record_;
}

Watermarks Session::watermarks() const {
  std::lock_guard lock(mutex_);
  // The end of the drive is the server's own; the robot counts its frames.
  const auto frames = [this](std::int64_t count) {
    return ended_ ? std::min(count, received_ - 1) : count;
  };
  return {frames(received_), frames(durable_), frames(processed_), record_.complete};
}

std::optional<localization::PoseEstimate> Session::newest_pose() const {
  std::lock_guard lock(mutex_);
  return newest_pose_;
}

std::optional<localization::OdometryFrame> Session::odometry_frame() const {
  std::lock_guard lock(mutex_);
  return odometry_frame_;
}

std::int64_t Session::bytes_in_flight() const {
  std::lock_guard lock(mutex_);
  return bytes_in_flight_;
}

absl::Status Session::fault() const {
  std::lock_guard lock(mutex_);
  return fault_;
}

std::int64_t Session::Attach(std::int64_t epoch, std::function<void()> wake) {
  std::lock_guard lock(mutex_);
  Wake();  // the stream before this one finds itself fenced
  stream_epoch_ = epoch;
  storage_trouble_ = absl::OkStatus();  // the new stream has another try
  wake_ = std::move(wake);
  return ended_ ? received_ - 1 : received_;
}

void Session::Detach(std::int64_t epoch) {
  std::lock_guard lock(mutex_);
  if (stream_epoch_ != epoch) return;
  stream_epoch_ = 0;
  wake_ = nullptr;
}

bool Session::streaming() const {
  std::lock_guard lock(mutex_);
  return stream_epoch_ != 0;
}

absl::Status Session::StreamStatus(std::int64_t epoch) const {
  std::lock_guard lock(mutex_);
  return CheckStream(epoch);
}

absl::Status Session::CheckStream(std::int64_t epoch) const {
  if (epoch != stream_epoch_) {
    return absl::AbortedError(absl::StrCat("session '", record_.session,
                                           "' was taken over by a newer stream of its robot"));
  }
  return fault_.ok() ? storage_trouble_ : fault_;
}

absl::StatusOr<Session::Taken> Session::Receive(std::int64_t epoch, std::int64_t offset,
                                                recording::Message message) {
  {
    std::lock_guard lock(mutex_);
    const absl::Status stream = CheckStream(epoch);
    if (!stream.ok()) return stream;
    if (offset < 0) return absl::InvalidArgumentError("an offset is negative");
    if (offset > received_) return Taken::kGap;
    if (offset < received_ - (ended_ ? 1 : 0)) {
      const auto crc = log_ ? log_->PayloadCrc(offset) : std::nullopt;
      if (crc && *crc != storage::Crc32c(message.data)) {
        return absl::DataLossError(absl::StrCat("frame ", offset, " of session '", record_.session,
                                                "' was sent again with other bytes"));
      }
      return Taken::kDuplicate;
    }
    if (ended_) {
      return absl::FailedPreconditionError(absl::StrCat(
          "session '", record_.session, "' has ended after ", received_ - 1, " frames"));
    }
  }
  // One stream at a time sends frames, so that nothing comes between the check and the append but a
  // newer stream, which is looked for again.
  auto item = Decode(message);
  if (!item.ok()) {
    return absl::Status(item.status().code(),
                        absl::StrCat("frame ", offset, ": ", std::string(item.status().message())));
  }
  std::lock_guard lock(mutex_);
  const absl::Status stream = CheckStream(epoch);
  if (!stream.ok()) return stream;
  if (offset != received_) return Taken::kGap;
  const auto appended = log_->Append(std::move(message));
  if (!appended.ok()) return appended.status();
  Queue(*std::move(item));
  return Taken::kYes;
}

absl::Status Session::Finish(std::int64_t epoch, std::int64_t frame_count) {
  std::lock_guard lock(mutex_);
  const absl::Status stream = CheckStream(epoch);
  if (!stream.ok()) return stream;
  const std::int64_t have = received_ - (ended_ ? 1 : 0);
  if (frame_count != have) {
    return absl::FailedPreconditionError(absl::StrCat("session '", record_.session, "' has ", have,
                                                      " frames, but was finished with ",
                                                      frame_count));
  }
  if (ended_) {
    Wake();
    return absl::OkStatus();
  }
  recording::Message end;
  end.topic = kEndTopic;
  end.schema = kEndSchema;
  end.log_time_ns = end.publish_time_ns = record_.last_frame_ns;
  end.data = kEndPayload;
  const auto appended = log_->Append(std::move(end));
  if (!appended.ok()) return appended.status();
  Queue({End{}, record_.last_frame_ns, 0});
  ended_ = true;
  return absl::OkStatus();
}

void Session::Queue(Item item) {
  if (queue_bytes_ + item.payload_bytes > kQueueBytes) {
    queue_.clear();
    queue_bytes_ = 0;
  }
  pending_.push_back({item.payload_bytes, std::chrono::steady_clock::now()});
  AddInFlight(item.payload_bytes);
  queue_bytes_ += item.payload_bytes;
  queue_.push_back(std::move(item));
  ++received_;
}

void Session::TakeClockOffset(const ClockOffset& offset) {
  std::lock_guard lock(mutex_);
  if (record_.complete || stopping_) return;
  const bool jumped = record_.Take(offset);
  if (stored_offset_) {
    const std::int64_t since_ns = std::abs(offset.time_ns - stored_offset_->time_ns);
    if (since_ns < (jumped ? kMinOffsetInterval_ns : kOffsetInterval_ns)) return;
  }
  stored_offset_ = offset;
  boost::asio::post(strand_, [self = shared_from_this()] {
    self->record_changed_ = true;
    self->StoreRecord().IgnoreError();  // the next commit tries again
  });
}

void Session::OnDurable(const absl::StatusOr<std::int64_t>& durable) {
  std::lock_guard lock(mutex_);
  if (!durable.ok()) {
    // A full disk passes; a damaged log does not.
    (absl::IsDataLoss(durable.status()) ? fault_ : storage_trouble_) = durable.status();
    Wake();
    return;
  }
  storage_trouble_ = absl::OkStatus();
  const auto now = std::chrono::steady_clock::now();
  for (; durable_ < *durable && !pending_.empty(); ++durable_) {
    if (site_.meters != nullptr) site_.meters->durable_lag.Add(now - pending_.front().received_at);
    AddInFlight(-pending_.front().payload_bytes);
    pending_.pop_front();
    AddBacklog(1);
  }
  Wake();
  if (!scheduled_ && !stopping_) {
    scheduled_ = true;
    boost::asio::post(strand_, [self = shared_from_this()] { self->Process(); });
  }
}

absl::StatusOr<std::int64_t> Session::NextEpoch() {
  const std::lock_guard record_lock(record_mutex_);
  SessionRecord record = this->record();
  ++record.epoch;
  const absl::Status stored = site_.store->PutRecord(
      storage::Table::kSession, absl::StrCat(record.site, "/", record.session), ToJson(record));
  if (!stored.ok()) return stored;
  const std::lock_guard lock(mutex_);
  record_.epoch = record.epoch;
  return record_.epoch;
}

void Session::Process() {
  clock_.Start();
  std::int64_t read_to = 0;
  {
    std::lock_guard lock(mutex_);
    const std::int64_t queue_begin = received_ - static_cast<std::int64_t>(queue_.size());
    read_to = std::min(durable_, queue_begin);
    const std::int64_t batch_end = next_ + static_cast<std::int64_t>(batch_.size());
    if (batch_end == queue_begin) {
      while (next_ + static_cast<std::int64_t>(batch_.size()) < durable_ && !IsBatchFull()) {
        queue_bytes_ -= queue_.front().payload_bytes;
        batch_left_bytes_ += queue_.front().payload_bytes;
        batch_.push_back(std::move(queue_.front()));
        queue_.pop_front();
      }
    }
    const bool to_read = next_ + static_cast<std::int64_t>(batch_.size()) < read_to;
    if (stopping_ || !fault_.ok() || (batch_.empty() && !to_read && !IsBehind())) {
      scheduled_ = false;
      clock_.Stop(Stage::kSession);
      return;
    }
  }
  const bool behind = IsBehind();
  const absl::Status read = behind ? CatchUp() : ReadBatch(read_to);
  if (!read.ok()) return Fail(read);
  if (!behind) {
    // What the robot has heard comes into the map in the order of the drive: as soon as it knows
    // where it was, before it drives on.
    for (; !batch_.empty() && !IsBehind(); batch_.pop_front()) {
      batch_left_bytes_ -= batch_.front().payload_bytes;
      Apply(std::move(batch_.front()));
    }
  }
  CommitAndGoOn();
}

void Session::Fail(const absl::Status& status) {
  std::lock_guard lock(mutex_);
  fault_ = status;
  scheduled_ = false;
  Wake();
  clock_.Stop(Stage::kSession);
}

bool Session::IsBatchFull() const {
  return batch_.size() >= kBatchFrames || batch_left_bytes_ >= kBatchBytes;
}

absl::Status Session::ReadBatch(std::int64_t end) {
  std::int64_t offset = next_ + static_cast<std::int64_t>(batch_.size());
  if (offset >= end) {
    unread_.reset();
    return absl::OkStatus();
  }
  if (IsBatchFull()) return absl::OkStatus();
  if (unread_ && unread_->next_offset() == offset) {
    const absl::Status extended = log_->Extend(*unread_);
    if (!extended.ok()) return extended;
  } else {
    auto reader = log_->Read(offset);
    if (!reader.ok()) return reader.status();
    unread_ = *std::move(reader);
  }
  for (; offset < end && !IsBatchFull(); ++offset) {
    const auto message = unread_->Next();
    if (!message.ok()) return message.status();
    if (!message->has_value()) return absl::DataLossError("the session log ends early");
    auto item = Decode(**message);
    if (!item.ok()) return item.status();
    batch_left_bytes_ += item->payload_bytes;
    batch_.push_back(*std::move(item));
  }
  return absl::OkStatus();
}

bool Session::IsBehind() const { return listening_ && heard_ < next_ && !listening_->waits(); }

absl::Status Session::CatchUp() {
  if (!unheard_) {
    auto reader = log_->Read(heard_);
    if (!reader.ok()) return reader.status();
    unheard_ = *std::move(reader);
  }
  for (int i = 0; i < kBatchFrames && IsBehind(); ++i) {
    const auto message = unheard_->Next();
    if (!message.ok()) return message.status();
    if (!message->has_value()) return absl::DataLossError("the session log ends early");
    auto item = Decode(**message);
    if (!item.ok()) return item.status();
    heard_ns_ = std::max(heard_ns_, item->log_time_ns);
    Listening::Output output;
    Hear(*std::move(item), output);
    TakeScans(heard_++, std::move(output.scans));
  }
  if (!IsBehind()) unheard_.reset();
  return absl::OkStatus();
}

void Session::CommitAndGoOn() {
  absl::Status status = Commit();
  if (status.ok() && finished_) status = Complete();
  clock_.Stop(Stage::kSession);
  if (!status.ok()) {
    {
      std::lock_guard lock(mutex_);
      storage_trouble_ = status;
      Wake();
    }
    retry_.expires_after(kCommitRetry);
    retry_.async_wait([self = shared_from_this()](boost::system::error_code cancelled) {
      if (!cancelled) self->CommitAndGoOn();
    });
    return;
  }
  boost::asio::post(strand_, [self = shared_from_this()] { self->Process(); });
}

void Session::Apply(Item item) {
  const std::int64_t offset = next_++;
  if (batch_first_ns_ == 0) batch_first_ns_ = item.log_time_ns;
  batch_last_ns_ = std::max(batch_last_ns_, item.log_time_ns);  // the end has that of some frame
  if (std::holds_alternative<End>(item.content)) finished_ = true;
  if (auto* gap = std::get_if<Gap>(&item.content)) {
    gap->offset = offset;
    Keep(*gap);
  }
  if (!listening_) {
    heard_ = next_;
    return;
  }

  Listening::Output output;
  if (const auto* frame = std::get_if<frames::Frame>(&item.content)) {
    listening_->Localize(*frame, output);
  }
  if (finished_) {
    listening_->Finish(output);
    heard_ = next_;
  } else if (heard_ == offset && !listening_->waits()) {
    Hear(std::move(item), output);
    heard_ = next_;
  }
  TakeScans(offset, std::move(output.scans));
  if (offset >= stored_poses_) {
    for (const localization::PoseEstimate& pose : output.path) {
      commit_.trajectory.push_back({pose.stamp_ns, EncodePose(pose)});
    }
  }
  if (!output.path.empty()) {
    std::lock_guard lock(mutex_);
    newest_pose_ = output.path.back();
  }
}

void Session::Hear(Item item, Listening::Output& output) {
  if (auto* frame = std::get_if<frames::Frame>(&item.content)) {
    listening_->Hear(std::move(*frame), output);
  } else {
    listening_->SkipHearing();
  }
}

void Session::Keep(const Gap& gap) {
  std::lock_guard lock(mutex_);
  std::vector<Gap>& gaps = record_.gaps;
  // After a crash it comes again.
  if (!gaps.empty() && gap.offset <= gaps.back().offset) return;
  if (gaps.size() < kMaxGaps) {
    gaps.push_back(gap);
  } else {
    gaps.back().offset = gap.offset;
    gaps.back().frames += gap.frames;
    gaps.back().to_ns = gap.to_ns;
  }
  record_changed_ = true;
  if (site_.meters != nullptr) site_.meters->lost_frames += gap.frames;
}

void Session::TakeScans(std::int64_t offset, std::vector<Listening::Scan> scans) {
  if (offset < stored_evidence_) return;
  for (Listening::Scan& scan : scans) {
    const AudioScanInfo info{robot_,
                             commit_.session,
                             scan.evidence.stamp_ns,
                             scan.pose,
                             scan.audio.noise_floor,
                             std::move(scan.audio.peaks),
                             static_cast<std::int64_t>(scan.evidence.end_points.size()),
                             std::move(scan.heard),
                             scan.array_plane,
                             scan.full_scale_spl_db,
                             scan.array_in_map_m,
                             scan.band};
    commit_.journal.push_back({offset, EncodeAudioScan(info), std::move(scan.evidence)});
  }
}

absl::Status Session::StoreRecord() {
  if (!record_changed_) return absl::OkStatus();
  const std::lock_guard record_lock(record_mutex_);  // no older record replaces NextEpoch()'s
  const absl::Status stored = site_.store->PutRecord(
      storage::Table::kSession, absl::StrCat(commit_.site, "/", commit_.session), ToJson(record()));
  if (stored.ok()) record_changed_ = false;
  return stored;
}

absl::Status Session::Commit() {
  const absl::Status record_stored = StoreRecord();
  if (!record_stored.ok()) return record_stored;
  if (commit_.processed_offset != next_ || commit_.heard_offset != heard_) {
    commit_.processed_offset = next_;
    commit_.heard_offset = heard_;
    if (snapshot_ns_ == 0) snapshot_ns_ = batch_last_ns_;
    if (heard_ == next_) heard_ns_ = std::max(heard_ns_, batch_last_ns_);
    if (snapshot_heard_ns_ == 0) snapshot_heard_ns_ = heard_ns_;
    // A lost robot is localized without being heard; found, it is heard without being localized.
    if (listening_ && !finished_ &&
        (batch_last_ns_ - snapshot_ns_ >= kSnapshotInterval_ns ||
         heard_ns_ - snapshot_heard_ns_ >= kSnapshotInterval_ns)) {
      clock_.Lap(Stage::kSession);
      commit_.state = storage::StateSnapshot{next_, listening_->SaveState()};
      clock_.Lap(Stage::kState);
      snapshot_ns_ = batch_last_ns_;
      snapshot_heard_ns_ = heard_ns_;
    }
    clock_.Lap(Stage::kSession);
    const absl::Status committed = site_.region->Commit(commit_, clock_);
    if (!committed.ok()) {
      commit_.processed_offset = -1;  // to be tried again
      return committed;
    }
    commit_.journal.clear();
    commit_.trajectory.clear();
    commit_.state.reset();
  }
  std::unique_lock lock(mutex_);
  AddBacklog(processed_ - next_);
  processed_ = next_;
  if (record_.first_frame_ns == 0) record_.first_frame_ns = batch_first_ns_;
  record_.last_frame_ns = std::max(record_.last_frame_ns, batch_last_ns_);
  if (listening_) {
    record_.audio_scans = listening_->counters().audio_scans;
    odometry_frame_ = listening_->odometry_frame();
  }
  RobotInfo robot{record_.robot,         record_.site, record_.session,
                  stream_epoch_ != 0,    newest_pose_, record_.last_frame_ns,
                  record_.lost_frames(), std::nullopt, record_.newest_offset()};
  Wake();
  lock.unlock();
  site_.region->events().Publish(std::move(robot));
  return absl::OkStatus();
}

absl::Status Session::Complete() {
  // Who knows that a drive is processed also finds its sources.
  site_.region->FindSources();
  clock_.Lap(Stage::kSources);
  const std::lock_guard record_lock(record_mutex_);
  std::unique_lock lock(mutex_);
  if (record_.complete) return absl::OkStatus();
  SessionRecord record = record_;
  record.complete = true;
  record.frame_count = received_ - 1;
  lock.unlock();
  if (listening_) {
    for (std::string& warning : listening_->Warnings()) {
      record.warnings.push_back(std::move(warning));
    }
  }
  const absl::Status stored = site_.store->PutRecord(
      storage::Table::kSession, absl::StrCat(record.site, "/", record.session), ToJson(record));
  if (!stored.ok()) return stored;
  unread_.reset();
  lock.lock();
  record_.complete = true;
  record_.frame_count = record.frame_count;
  record_.warnings = std::move(record.warnings);
  listening_.reset();
  log_.reset();
  Wake();
  lock.unlock();
  site_.store->DropState(id()).IgnoreError();  // it would only take space
  return site_.store->CloseSession(id());
}

absl::StatusOr<bool> Session::DropFrames(std::int64_t begun_before_ns) {
  const std::lock_guard record_lock(record_mutex_);
  SessionRecord record;
  {
    std::lock_guard lock(mutex_);
    if (stopping_ || !record_.complete || record_.frames_dropped ||
        record_.purpose != Purpose::kListening || record_.create_time_ns >= begun_before_ns) {
      return false;
    }
    record = record_;
  }
  const absl::Status dropped = site_.store->DropFrames(id());
  if (!dropped.ok()) return dropped;
  record.frames_dropped = true;
  const absl::Status stored = site_.store->PutRecord(
      storage::Table::kSession, absl::StrCat(record.site, "/", record.session), ToJson(record));
  if (!stored.ok()) return stored;
  std::lock_guard lock(mutex_);
  record_.frames_dropped = true;
  return true;
}

void Session::AddInFlight(std::int64_t bytes) {
  bytes_in_flight_ += bytes;
  if (site_.meters != nullptr) site_.meters->bytes_in_flight += bytes;
}

void Session::AddBacklog(std::int64_t frames) {
  backlog_frames_ += frames;
  if (site_.meters != nullptr) site_.meters->backlog_frames += frames;
}

void Session::Wake() {
  if (wake_) wake_();
}

void Session::AskToStop() {
  std::lock_guard lock(mutex_);
  stopping_ = true;
}

void Session::Stop() {
  AskToStop();
  std::promise<void> idle;
  boost::asio::post(strand_, [this, &idle] {
    retry_.cancel();
    idle.set_value();
  });
  idle.get_future().wait();
  const std::lock_guard record_lock(record_mutex_);  // nor are frames being dropped
  std::lock_guard lock(mutex_);
  AddInFlight(-bytes_in_flight_);
  AddBacklog(-backlog_frames_);
}

}  // namespace soundmap::pipeline
