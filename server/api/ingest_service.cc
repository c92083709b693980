#include "api/ingest_service.h"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "api/find.h"
#include "api/status.h"
#include "api/wake.h"
#include "recording/frame_coding.h"
#include "storage/crc32c.h"

namespace soundmap::api {
namespace {

constexpr std::int64_t kMaxChunkBytes = 256 << 10;
constexpr std::int64_t kMaxFrameBytes = 16 << 20;
// Payload of one robot that may be on its way or wait to be processed.
constexpr std::int64_t kWindowBytes = 8 << 20;

struct SensorFormat {
  const char* topic;
  const char* schema;
};

// The topics of the session log are those of a recording.
std::optional<SensorFormat> FormatOf(v1::Sensor sensor) {
  switch (sensor) {
    case v1::SENSOR_AUDIO:
      return SensorFormat{"/audio", "foxglove.RawAudio"};
    case v1::SENSOR_LIDAR:
      return SensorFormat{"/lidar/points", "foxglove.PointCloud"};
    case v1::SENSOR_LASER:
      return SensorFormat{"/scan", "foxglove.LaserScan"};
    case v1::SENSOR_ODOMETRY:
      return SensorFormat{"/odom", "foxglove.Odometry"};
    case v1::SENSOR_GAP:
      return SensorFormat{"/session/gap", "foxglove.KeyValuePair"};
    default:
      return std::nullopt;
  }
}

// What the frame, or the part of one, takes of the robot's credit: its bytes before it was coded.
std::int64_t CreditFor(const v1::Frame& frame) {
  if (frame.coding() == v1::CODING_UNSPECIFIED) {
    return static_cast<std::int64_t>(frame.payload().size());
  }
  const std::int64_t parts = std::max<std::int64_t>(frame.part_count(), 1);
  return (frame.message_bytes() + parts - 1) / parts;
}

}  // namespace

// One robot's stream. gRPC calls the On...() functions one at a time per kind; the pipeline wakes
// it from the executor.
class IngestService::Stream : public grpc::ServerBidiReactor<v1::IngestRequest, v1::IngestResponse>,
                              public std::enable_shared_from_this<IngestService::Stream> {
 public:
  Stream(IngestService* service, Caller caller) : service_(service), caller_(std::move(caller)) {
    ++service_->sites_->meters().streams;
  }

  void Start() {
    alive_ = shared_from_this();
    StartRead(&request_);
  }

  void OnReadDone(bool ok) override {
    if (!ok) {
      // The robot has closed its side. After `finish` it waits for the end of processing.
      std::lock_guard lock(mutex_);
      if (!finish_requested_) End(absl::OkStatus());
      return;
    }
    const absl::Status handled = Handle();
    if (!handled.ok()) {
      std::lock_guard lock(mutex_);
      End(handled);
      return;
    }
    Pump();
    StartRead(&request_);
  }

  void OnWriteDone(bool ok) override {
    std::lock_guard lock(mutex_);
    writing_ = false;
    if (!ok) End(absl::CancelledError("the robot is gone"));
    if (end_status_) {
      FinishOnce();
    } else {
      WriteNext();
    }
  }

  void OnCancel() override {
    std::lock_guard lock(mutex_);
    End(absl::CancelledError("the robot is gone"));
  }

  void OnDone() override {
    if (session_) session_->Detach(epoch_);
    --service_->sites_->meters().streams;
    {
      std::lock_guard lock(service_->mutex_);
      service_->streams_.erase(this);
    }
    alive_.reset();  // deletes this, unless a wake still holds it
  }

  void Drain() {
    std::lock_guard lock(mutex_);
    drain_ = true;
    WriteNext();
  }

 private:
  absl::Status Handle() {
    switch (request_.message_case()) {
      case v1::IngestRequest::kOpen:
        return HandleOpen(request_.open());
      case v1::IngestRequest::kChunk: {
        pipeline::Meters& meters = service_->sites_->meters();
        pipeline::StageClock clock(&meters.stages);
        clock.Start();
        meters.received_bytes += static_cast<std::int64_t>(request_.ByteSizeLong());
        absl::Status handled = service_->access_->Recheck(caller_);
        if (handled.ok()) handled = HandleChunk(*request_.mutable_chunk());
        clock.Stop(pipeline::Stage::kReceive);
        return handled;
      }
      case v1::IngestRequest::kFinish:
        if (!session_) return absl::FailedPreconditionError("the first message must be `open`");
        {
          std::lock_guard lock(mutex_);
          finish_requested_ = true;
        }
        return session_->Finish(epoch_, request_.finish().frame_count());
      default:
        return absl::InvalidArgumentError("an ingest message is empty");
    }
  }

  absl::Status HandleOpen(const v1::Open& open) {
    if (session_) return absl::FailedPreconditionError("`open` came twice");
    const auto session =
        FindSession(*service_->sites_, open.session(), Right::kRead, *service_->access_, caller_);
    if (!session.ok()) return session.status();
    const pipeline::SessionRecord record = (*session)->record();
    const absl::Status allowed =
        service_->access_->Check(caller_, Right::kStream, record.site, record.robot);
    if (!allowed.ok()) return allowed;
    if (open.epoch() != record.epoch) {
      return absl::AbortedError(absl::StrCat("epoch ", open.epoch(), " of session '",
                                             open.session(), "' is not its newest"));
    }
    epoch_ = open.epoch();
    session_ = *session;
    const std::int64_t resume_offset = session_->Attach(
        epoch_, Wake(service_->executor_, std::chrono::milliseconds(0), [weak = weak_from_this()] {
          if (const auto self = weak.lock()) self->Pump();
        }));
    std::lock_guard lock(mutex_);
    v1::Welcome& welcome = welcome_.emplace();
    welcome.set_resume_offset(resume_offset);
    welcome.mutable_limits()->set_max_chunk_bytes(kMaxChunkBytes);
    welcome.mutable_limits()->set_max_frame_bytes(kMaxFrameBytes);
    for (const v1::Coding coding : {v1::CODING_FLAC, v1::CODING_POINTS, v1::CODING_ZSTD}) {
      welcome.add_codings(coding);
    }
    return absl::OkStatus();
  }

  absl::Status HandleChunk(v1::Chunk& chunk) {
    if (!session_) return absl::FailedPreconditionError("the first message must be `open`");
    std::int64_t bytes = 0;
    std::int64_t credit = 0;
    std::uint32_t crc = 0;
    for (const v1::Frame& frame : chunk.frames()) {
      credit += CreditFor(frame);
      bytes += static_cast<std::int64_t>(frame.payload().size());
      crc = storage::Crc32c(frame.payload(), crc);
    }
    const std::string where = absl::StrCat("the chunk at offset ", chunk.first_offset());
    if (bytes > kMaxChunkBytes) {
      return absl::InvalidArgumentError(
          absl::StrCat(where, " has ", bytes, " bytes; ", kMaxChunkBytes, " are the limit"));
    }
    if (crc != chunk.crc32c()) {
      return absl::InvalidArgumentError(absl::StrCat(where, " does not match its checksum"));
    }
    {
      std::lock_guard lock(mutex_);
      // One frame may be larger than the window.
      const std::int64_t needed =
          chunk.frames_size() == 1 ? std::min(credit, kMaxChunkBytes) : credit;
      if (received_bytes_ + needed > granted_bytes_) {
        return absl::ResourceExhaustedError("the robot sends more than it has credit for");
      }
      received_bytes_ += credit;
    }
    std::int64_t offset = chunk.first_offset();
    for (v1::Frame& frame : *chunk.mutable_frames()) {
      const auto format = FormatOf(frame.sensor());
      if (!format) {
        return absl::InvalidArgumentError(absl::StrCat(where, " has a frame of no known sensor"));
      }
      if (frame.part_count() > 0) {
        if (chunk.frames_size() != 1) {
          return absl::InvalidArgumentError(
              absl::StrCat(where, " has a part of a frame and something else"));
        }
        const absl::StatusOr<bool> whole = TakePart(frame, offset);
        if (!whole.ok()) return whole.status();
        if (!*whole) return absl::OkStatus();
        frame.set_payload(std::exchange(parts_, {}));
        next_part_ = 0;
      }
      if (frame.coding() != v1::CODING_UNSPECIFIED) {
        const absl::Status decoded = Decode(frame, offset);
        if (!decoded.ok()) return decoded;
      }
      recording::Message message;
      message.topic = format->topic;
      message.schema = format->schema;
      message.log_time_ns = static_cast<std::int64_t>(frame.log_time_ns());
      message.publish_time_ns = message.log_time_ns;
      message.data = std::move(*frame.mutable_payload());
      const auto taken = session_->Receive(epoch_, offset, std::move(message));
      if (!taken.ok()) return taken.status();
      if (*taken == pipeline::Session::Taken::kGap) {
        std::lock_guard lock(mutex_);
        // The chunks that were on their way when this was said are gaps too; it is said once.
        if (!gap_open_) rewind_ = session_->watermarks().received;
        gap_open_ = true;
        return absl::OkStatus();
      }
      gap_open_ = false;
      ++offset;
    }
    return absl::OkStatus();
  }

  // Makes the payload the message that it stands for.
  static absl::Status Decode(v1::Frame& frame, std::int64_t offset) {
    if (frame.message_bytes() > kMaxFrameBytes) {
      return absl::InvalidArgumentError(
          absl::StrCat("frame ", offset, " is larger than ", kMaxFrameBytes, " bytes"));
    }
    auto message = recording::DecodeFrame(frame.coding(), frame.payload(), frame.message_bytes());
    if (!message.ok()) {
      return absl::Status(message.status().code(),
                          absl::StrCat("frame ", offset, ": ", message.status().message()));
    }
    frame.set_payload(*std::move(message));
    return absl::OkStatus();
  }

  // True when this was the last part. Parts of a frame come in order; any other part begins anew or
  // is an error.
  absl::StatusOr<bool> TakePart(const v1::Frame& frame, std::int64_t offset) {
    if (frame.part() == 0) {
      parts_.clear();
      next_part_ = 0;
    }
    if (frame.part() != next_part_ || frame.part() >= frame.part_count() ||
        (next_part_ > 0 && offset != parts_offset_)) {
      return absl::InvalidArgumentError(
          absl::StrCat("frame ", offset, " came in parts out of order"));
    }
    if (static_cast<std::int64_t>(parts_.size() + frame.payload().size()) > kMaxFrameBytes) {
      return absl::InvalidArgumentError(
          absl::StrCat("frame ", offset, " is larger than ", kMaxFrameBytes, " bytes"));
    }
    parts_offset_ = offset;
    parts_.append(frame.payload());
    return ++next_part_ == frame.part_count();
  }

  // Sends what is new: called when a message came in and when the session went on.
  void Pump() {
    if (!session_) return;
    const absl::Status stream = session_->StreamStatus(epoch_);
    std::lock_guard lock(mutex_);
    if (!stream.ok()) {
      End(stream);
      return;
    }
    WriteNext();
  }

  // With mutex_ held.
  void WriteNext() {
    if (writing_ || end_status_) return;
    response_.Clear();
    if (!FillResponse()) return;
    writing_ = true;
    StartWrite(&response_);
  }

  // With mutex_ held. False: nothing to say.
  bool FillResponse() {
    if (welcome_) {
      *response_.mutable_welcome() = *std::exchange(welcome_, std::nullopt);
      welcomed_ = true;
      return true;
    }
    if (drain_) {
      if (std::exchange(drain_said_, true)) {
        End(absl::UnavailableError("the server is stopping"));
        return false;
      }
      response_.mutable_drain();
      return true;
    }
    if (!welcomed_) return false;
    if (rewind_) {
      response_.mutable_rewind()->set_offset(*std::exchange(rewind_, std::nullopt));
      return true;
    }
    const pipeline::Watermarks marks = session_->watermarks();
    if (marks.received != acked_.received || marks.durable != acked_.durable ||
        marks.processed != acked_.processed) {
      acked_ = marks;
      response_.mutable_ack()->set_received(marks.received);
      response_.mutable_ack()->set_durable(marks.durable);
      response_.mutable_ack()->set_processed(marks.processed);
      return true;
    }
    if (finish_requested_ && marks.complete) {
      End(absl::OkStatus());
      return false;
    }
    const std::int64_t outstanding = granted_bytes_ - received_bytes_ + session_->bytes_in_flight();
    const std::int64_t credit = kWindowBytes - outstanding;
    if (credit >= kWindowBytes / 8) {
      granted_bytes_ += credit;
      response_.mutable_credit()->set_bytes(credit);
      return true;
    }
    return false;
  }

  // With mutex_ held. The first status counts; a write that is under way ends first.
  void End(const absl::Status& status) {
    if (!end_status_) end_status_ = status;
    if (!writing_) FinishOnce();
  }
  void FinishOnce() {
    if (std::exchange(finished_, true)) return;
    Finish(ToGrpcStatus(*end_status_));
  }

  IngestService* const service_;
  const Caller caller_;
  std::shared_ptr<Stream> alive_;
  v1::IngestRequest request_;

  // Set by `open`, before anything wakes.
  std::shared_ptr<pipeline::Session> session_;
  std::int64_t epoch_ = 0;

  // The reading side's own.
  std::string parts_;
  std::int64_t parts_offset_ = 0;
  std::uint32_t next_part_ = 0;
  bool gap_open_ = false;

  std::mutex mutex_;
  // Guarded by mutex_.
  v1::IngestResponse response_;
  bool writing_ = false;
  bool finished_ = false;
  std::optional<absl::Status> end_status_;
  std::optional<v1::Welcome> welcome_;
  bool welcomed_ = false;
  std::optional<std::int64_t> rewind_;
  bool drain_ = false;
  bool drain_said_ = false;
  bool finish_requested_ = false;
  pipeline::Watermarks acked_{-1, -1, -1, false};
  std::int64_t granted_bytes_ = 0;
  std::int64_t received_bytes_ = 0;
};

IngestService::IngestService(pipeline::Sites* sites, Access* access,
                             boost::asio::any_io_executor executor)
    : sites_(sites), access_(access), executor_(std::move(executor)) {}

IngestService::~IngestService() = default;

grpc::ServerBidiReactor<v1::IngestRequest, v1::IngestResponse>* IngestService::Ingest(
    grpc::CallbackServerContext* context) {
  auto caller = access_->CallerOf(*context);
  if (!caller.ok()) {
    class Refusal : public grpc::ServerBidiReactor<v1::IngestRequest, v1::IngestResponse> {
     public:
      explicit Refusal(const absl::Status& status) { Finish(ToGrpcStatus(status)); }
      void OnDone() override { delete this; }
    };
    return new Refusal(caller.status());
  }
  auto stream = std::make_shared<Stream>(this, *std::move(caller));
  bool draining = false;
  {
    std::lock_guard lock(mutex_);
    streams_.insert(stream.get());
    draining = draining_;
  }
  stream->Start();
  if (draining) stream->Drain();
  return stream.get();
}

void IngestService::Drain() {
  std::lock_guard lock(mutex_);
  draining_ = true;
  for (Stream* stream : streams_) stream->Drain();
}

}  // namespace soundmap::api
