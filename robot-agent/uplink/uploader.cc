#include "uplink/uploader.h"

#include <algorithm>
#include <cmath>
#include <thread>
#include <utility>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "google/rpc/status_details.pb.h"
#include "recording/frame_coding.h"
#include "sources/sensor_format.h"
#include "uplink/chunk_builder.h"

namespace soundmap::uplink {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr std::int64_t kMaxChunkBytes = 256 << 10;
constexpr int kMaxChunkFrames = 2048;
constexpr std::chrono::seconds kCallTimeout{30};
// How often a source that has no more yet is asked again.
constexpr milliseconds kPollInterval{50};

// Frames become due by their log time, counted from the first one that is sent.
class Pace {
 public:
  Pace(std::optional<double> speed, const Uploader::Clock& clock) : speed_(speed), clock_(clock) {}

  // How long until the frame is due; zero or less: it is.
  nanoseconds Wait(std::int64_t log_time_ns) {
    if (!speed_) return nanoseconds(0);
    if (!started_) {
      started_ = true;
      start_ = clock_();
      start_log_time_ns_ = log_time_ns;
    }
    const double due_ns = static_cast<double>(log_time_ns - start_log_time_ns_) / *speed_;
    return nanoseconds(static_cast<std::int64_t>(std::clamp(due_ns, -1e18, 1e18))) -
           (clock_() - start_);
  }

 private:
  const std::optional<double> speed_;
  const Uploader::Clock& clock_;
  bool started_ = false;
  std::chrono::steady_clock::time_point start_;
  std::int64_t start_log_time_ns_ = 0;
};

// The frames still to be sent, one looked ahead, coded.
class Outbox {
 public:
  Outbox(sources::FrameSource& source, recording::FrameCoding coding)
      : source_(source), coding_(std::move(coding)) {}

  absl::Status Seek(std::int64_t offset) {
    if (absl::Status status = source_.Seek(offset); !status.ok()) return status;
    offset_ = offset;
    return Load();
  }
  // Drops the frame at hand.
  absl::Status Advance() {
    ++offset_;
    return Load();
  }

  // The frame at hand, at offset(), of which the parts before part() are sent; none at the end.
  const std::optional<OutgoingFrame>& frame() const { return frame_; }
  std::int64_t offset() const { return offset_; }
  std::uint32_t part() const { return part_; }
  void AdvancePart() { ++part_; }

  // Looks for the frame at hand again, after there was none.
  absl::Status Load() {
    part_ = 0;
    frame_.reset();
    auto frame = source_.Next();
    if (!frame.ok()) return frame.status();
    if (!*frame) return absl::OkStatus();
    frame_ = OutgoingFrame{**std::move(frame)};
    frame_->message_bytes = frame_->payload_bytes();
    recording::CodedFrame coded = recording::CodeFrame(
        sources::FormatOf(frame_->frame.sensor).schema, frame_->frame.payload, coding_);
    if (coded.coding != v1::CODING_UNSPECIFIED) {
      frame_->coding = coded.coding;
      frame_->frame.payload = std::move(coded.bytes);
    }
    return absl::OkStatus();
  }

 private:
  sources::FrameSource& source_;
  const recording::FrameCoding coding_;
  std::optional<OutgoingFrame> frame_;
  std::int64_t offset_ = 0;
  std::uint32_t part_ = 0;
};

bool IsRetryable(const absl::Status& status, bool with_retry_info) {
  return absl::IsUnavailable(status) || (absl::IsResourceExhausted(status) && with_retry_info);
}

}  // namespace

absl::Status UploadOptions::Validate() const {
  if (speed && !(*speed > 0.0 && std::isfinite(*speed))) {
    return absl::InvalidArgumentError("the speed must be a positive number");
  }
  return absl::OkStatus();
}

Uploader::Uploader(const std::shared_ptr<grpc::ChannelInterface>& channel, UploadOptions options,
                   Clock clock, std::mt19937_64 random)
    : options_(std::move(options)),
      clock_(std::move(clock)),
      random_(random),
      sessions_(v1::SessionService::NewStub(channel)),
      ingest_(v1::IngestService::NewStub(channel)) {}

absl::StatusOr<UploadResult> Uploader::Upload(
    sources::FrameSource& source, const std::function<void(const UploadProgress&)>& progress) {
  if (absl::Status status = options_.Validate(); !status.ok()) return status;
  progress_ = progress;
  result_ = {};
  now_ = {};
  auto trying_since = clock_();
  milliseconds backoff = options_.first_backoff;
  while (true) {
    progressed_ = false;
    const absl::Status status = Attempt(source);
    if (status.ok()) return result_;
    if (Stopped(milliseconds(0))) return absl::CancelledError("the upload was stopped");
    if (!IsRetryable(status, asked_delay_ > milliseconds(0))) return status;
    if (progressed_) {
      trying_since = clock_();
      backoff = options_.first_backoff;
    }
    const auto in_vain = clock_() - trying_since;
    if (in_vain >= options_.give_up_after) {
      return absl::Status(
          status.code(),
          absl::StrCat(status.message(), "; given up after ",
                       std::chrono::duration_cast<std::chrono::seconds>(in_vain).count(), " s"));
    }
    Report(std::string(status.message()));
    const milliseconds jitter(
        std::uniform_int_distribution<std::int64_t>(0, backoff.count())(random_));
    backoff = std::min(2 * backoff, options_.max_backoff);
    const auto left = std::chrono::duration_cast<milliseconds>(options_.give_up_after - in_vain);
    if (Stopped(std::min(asked_delay_ + jitter, left))) {
      return absl::CancelledError("the upload was stopped");
    }
  }
}

void Uploader::Stop() {
  {
    std::lock_guard lock(mutex_);
    stopped_ = true;
    if (context_ != nullptr) context_->TryCancel();
  }
  stop_.notify_all();
}

bool Uploader::Stopped(milliseconds time) {
  std::unique_lock lock(mutex_);
  return stop_.wait_for(lock, time, [this] { return stopped_; });
}

void Uploader::SetContext(grpc::ClientContext* context) {
  std::lock_guard lock(mutex_);
  context_ = context;
  if (stopped_ && context != nullptr) context->TryCancel();
}

absl::Status Uploader::Attempt(sources::FrameSource& source) {
  asked_delay_ = milliseconds(0);
  v1::Session session;
  const auto context = MakeContext();
  context->set_deadline(std::chrono::system_clock::now() + kCallTimeout);
  SetContext(context.get());
  const grpc::Status created = sessions_->CreateSession(context.get(), options_.session, &session);
  SetContext(nullptr);
  if (absl::Status status = FromServer(created); !status.ok()) return status;
  result_.session = session.name();
  if (session.state() == v1::SESSION_STATE_FAILED) {
    return absl::FailedPreconditionError(
        absl::StrCat("session '", session.name(), "' has failed: ", session.error_message()));
  }

  auto stream_context = MakeContext();
  grpc::ClientContext* const running = stream_context.get();
  IngestStream stream(*ingest_, std::move(stream_context));
  SetContext(running);
  const absl::Cleanup unset = [this] { SetContext(nullptr); };
  v1::IngestRequest open;
  open.mutable_open()->set_session(session.name());
  open.mutable_open()->set_epoch(session.epoch());
  open.mutable_open()->set_next_offset(now_.next_offset);
  stream.Write(open);
  const absl::StatusOr<bool> all_sent = SendFrames(stream, source);
  if (!all_sent.ok()) return all_sent.status();
  const grpc::Status end = stream.Finish();
  if (!end.ok()) return FromServer(end);
  if (!*all_sent) {
    return absl::UnavailableError(
        absl::StrCat("the server ", options_.server, " ended the stream before all was sent"));
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> Uploader::SendFrames(IngestStream& stream, sources::FrameSource& source) {
  IngestStream::State state = stream.state();
  while (!state.welcome && !state.ended) {
    stream.WaitForNews(state, std::nullopt);
    state = stream.state();
  }
  if (state.ended) return false;
  const v1::Limits limits = state.welcome->limits();
  const std::int64_t chunk_bytes = limits.max_chunk_bytes() > 0
                                       ? std::min(limits.max_chunk_bytes(), kMaxChunkBytes)
                                       : kMaxChunkBytes;
  recording::FrameCoding coding;
  coding.lidar_resolution_m = options_.lidar_resolution_m;
  for (const int offered : state.welcome->codings()) {
    if (options_.coded) coding.allowed.insert(static_cast<v1::Coding>(offered));
  }
  Outbox outbox(source, coding);
  Pace pace(options_.speed, clock_);
  if (absl::Status status = outbox.Seek(state.welcome->resume_offset()); !status.ok()) {
    return status;
  }
  bool finished = false;
  bool broken = false;  // nothing can be sent any more; the end is about to be told
  while (true) {
    state = stream.state();
    NoteProgress(state.watermarks);
    now_.next_offset = outbox.offset();
    Report();
    if (state.ended) return finished;
    if (const auto rewind = stream.TakeRewind()) {
      if (absl::Status status = outbox.Seek(*rewind); !status.ok()) return status;
      finished = false;
      continue;
    }
    if (finished || broken || state.drain) {
      stream.WaitForNews(state, std::nullopt);
      continue;
    }
    if (!outbox.frame() && !source.AtEnd()) {
      stream.WaitForNews(state, kPollInterval);
      if (absl::Status status = outbox.Load(); !status.ok()) return status;
      continue;
    }
    if (!outbox.frame()) {
      v1::IngestRequest finish;
      finish.mutable_finish()->set_frame_count(outbox.offset());
      result_.frame_count = outbox.offset();
      broken = !stream.Write(finish);
      finished = true;
      continue;
    }
    if (const nanoseconds wait = pace.Wait(outbox.frame()->frame.log_time_ns);
        wait > nanoseconds(0)) {
      stream.WaitForNews(state, wait);
      continue;
    }
    const std::int64_t message_bytes = outbox.frame()->message_bytes;
    if (limits.max_frame_bytes() > 0 && message_bytes > limits.max_frame_bytes()) {
      return absl::InvalidArgumentError(
          absl::StrCat("frame ", outbox.offset(), " of the drive has ", message_bytes,
                       " bytes; the server takes ", limits.max_frame_bytes()));
    }
    if (std::min(message_bytes, chunk_bytes) > state.credit_bytes) {
      stream.WaitForNews(state, std::nullopt);
      continue;
    }

    ChunkBuilder chunk(outbox.offset());
    const std::int64_t frame_bytes = outbox.frame()->payload_bytes();
    if (frame_bytes > chunk_bytes) {
      chunk.AddPart(*outbox.frame(), chunk_bytes, outbox.part());
      outbox.AdvancePart();
      if (outbox.part() * chunk_bytes >= frame_bytes) {
        ++result_.sent_count;
        result_.message_bytes += message_bytes;
        if (absl::Status status = outbox.Advance(); !status.ok()) return status;
      }
    } else {
      // The first may overdraw the credit.
      do {
        result_.message_bytes += outbox.frame()->message_bytes;
        chunk.Add(*outbox.frame());
        ++result_.sent_count;
        if (absl::Status status = outbox.Advance(); !status.ok()) return status;
      } while (outbox.frame() && chunk.frame_count() < kMaxChunkFrames &&
               chunk.payload_bytes() + outbox.frame()->payload_bytes() <= chunk_bytes &&
               chunk.credit_bytes() + outbox.frame()->message_bytes <= state.credit_bytes &&
               pace.Wait(outbox.frame()->frame.log_time_ns) <= nanoseconds(0));
    }
    result_.payload_bytes += chunk.payload_bytes();
    stream.SpendCredit(chunk.credit_bytes());
    broken = !stream.Write(chunk.Finish());
  }
}

void Uploader::Report(const std::string& trouble) {
  now_.trouble = trouble;
  if (progress_) progress_(now_);
}

void Uploader::NoteProgress(const Watermarks& watermarks) {
  if (watermarks.received > now_.watermarks.received ||
      watermarks.durable > now_.watermarks.durable ||
      watermarks.processed > now_.watermarks.processed) {
    progressed_ = true;
  }
  now_.watermarks = watermarks;
}

std::unique_ptr<grpc::ClientContext> Uploader::MakeContext() const {
  auto context = std::make_unique<grpc::ClientContext>();
  if (!options_.token.empty()) {
    context->AddMetadata("authorization", absl::StrCat("Bearer ", options_.token));
  }
  return context;
}

absl::Status Uploader::FromServer(const grpc::Status& status) {
  if (status.ok()) return absl::OkStatus();
  google::rpc::Status details;
  google::rpc::RetryInfo retry;
  if (details.ParseFromString(status.error_details())) {
    for (const google::protobuf::Any& detail : details.details()) {
      if (!detail.UnpackTo(&retry)) continue;
      asked_delay_ = milliseconds(std::clamp<std::int64_t>(
          retry.retry_delay().seconds() * 1000 + retry.retry_delay().nanos() / 1'000'000, 1,
          options_.max_backoff.count()));
    }
  }
  const std::string& message = status.error_message();
  const auto code = static_cast<absl::StatusCode>(status.error_code());
  if (!status.error_details().empty()) return absl::Status(code, message);
  // Not the server's words but gRPC's, on a connection that is not there or is lost.
  switch (code) {
    case absl::StatusCode::kUnavailable:
    case absl::StatusCode::kUnknown:
    case absl::StatusCode::kInternal:
    case absl::StatusCode::kCancelled:
    case absl::StatusCode::kDeadlineExceeded: {
      std::string why;
      if (absl::StrContains(message, "Connection refused")) why = ": connection refused";
      if (absl::StrContains(message, "DNS resolution failed")) why = ": no such host";
      if (absl::StrContains(message, "Ssl handshake") || absl::StrContains(message, "SSL_ERROR")) {
        why = ": the TLS handshake failed";
      }
      return absl::UnavailableError(absl::StrCat("cannot reach the server ", options_.server, why));
    }
    default:
      return absl::Status(code, absl::StrCat("the server ", options_.server, " says: ", message));
  }
}

}  // namespace soundmap::uplink
