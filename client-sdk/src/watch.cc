#include <condition_variable>
#include <mutex>
#include <stop_token>

#include "connection.h"
#include "convert.h"
#include "soundmap/client.h"

namespace soundmap {
namespace {

// What a server that stops, restarts or is cut off looks like from here.
bool MayComeBack(const grpc::Status& status) {
  return status.ok() || status.error_code() == grpc::StatusCode::UNAVAILABLE ||
         status.error_code() == grpc::StatusCode::CANCELLED;
}

void WaitUnlessStopped(std::chrono::milliseconds time, const std::stop_token& stop) {
  std::mutex mutex;
  std::unique_lock lock(mutex);
  std::condition_variable_any stopped;
  stopped.wait_for(lock, stop, time, [] { return false; });
}

}  // namespace

absl::Status Client::Watch(const WatchRequest& request, const WatchCallback& callback,
                           std::stop_token stop) {
  const ClientOptions& options = connection_->options;
  v1::WatchRequest wire;
  wire.set_site(internal::SiteName(request.site));
  wire.set_sound_sources(request.sound_sources);
  wire.set_robots(request.robots);
  wire.set_audio_scans(request.audio_scans);
  wire.set_resume_token(request.resume_token);
  wire.set_band(request.band);

  internal::Backoff backoff(options.retry);
  absl::BitGen random;
  int silent_attempts = 0;
  int max_silent_attempts = options.retry.max_attempts;
  while (!stop.stop_requested()) {
    grpc::ClientContext context;
    connection_->Prepare(context, std::chrono::milliseconds(0));
    const std::stop_callback on_stop(stop, [&context] { context.TryCancel(); });
    const auto reader = connection_->watches->Watch(&context, wire);
    bool resync = false;
    v1::WatchEvent message;
    ++silent_attempts;
    while (!resync && reader->Read(&message)) {
      if (silent_attempts != 0) {
        silent_attempts = 0;
        max_silent_attempts = options.max_silent_reconnects;
        backoff.Reset();
      }
      resync = message.event_case() == v1::WatchEvent::kResync;
      if (resync) {
        wire.clear_resume_token();
      } else if (!message.resume_token().empty()) {
        wire.set_resume_token(message.resume_token());
      }
      if (!callback(internal::FromProto(message))) {
        context.TryCancel();
        reader->Finish();
        return absl::OkStatus();
      }
    }
    if (resync) context.TryCancel();
    const grpc::Status status = reader->Finish();
    if (stop.stop_requested()) break;
    if (!resync && !MayComeBack(status)) {
      if (status.error_code() != grpc::StatusCode::OUT_OF_RANGE || wire.resume_token().empty()) {
        return connection_->Error(status);
      }
      // The server has forgotten the token.
      wire.clear_resume_token();
      WatchEvent forget;
      forget.event = Resync{};
      if (!callback(forget)) return absl::OkStatus();
    }
    if (silent_attempts >= max_silent_attempts) {
      return status.ok() ? absl::UnavailableError("the server ends the watch without a word")
                         : connection_->Error(status);
    }
    WaitUnlessStopped(backoff.Next(random), stop);
  }
  return absl::OkStatus();
}

}  // namespace soundmap
