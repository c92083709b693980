#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "soundmap/v1/ingest_service.grpc.pb.h"
#include "soundmap/v1/session_service.grpc.pb.h"
#include "sources/frame_source.h"
#include "uplink/ingest_stream.h"

namespace soundmap::uplink {

struct UploadOptions {
  std::string server;  // for sentences
  std::string token;   // bearer token; empty: none
  v1::CreateSessionRequest session;
  // Codes what the server decodes; otherwise every message travels as it is.
  bool coded = true;
  double lidar_resolution_m = 0.0;  // on whose multiples LIDAR points lie; 0: on none
  std::optional<double> speed;      // log times real time; none: as fast as the server takes it
  std::chrono::milliseconds give_up_after{60'000};  // of trying in vain
  std::chrono::milliseconds first_backoff{
      200};  // full jitter: before the n-th further attempt a random part of
  std::chrono::milliseconds max_backoff{5'000};  // min(max_backoff, first_backoff * 2^(n-1))

  absl::Status Validate() const;
};

struct UploadProgress {
  std::int64_t next_offset = 0;  // frames sent, those included that the server had already
  Watermarks watermarks;
  std::string trouble;  // why there is no connection at present; empty: there is one
};

struct UploadResult {
  std::string session;           // its resource name
  std::int64_t frame_count = 0;  // of the session
  std::int64_t sent_count =
      0;  // frames that went over the wire now; 0 when the server had all of them
  std::int64_t message_bytes = 0;  // of these, as they are
  std::int64_t payload_bytes = 0;  // and as they travelled
};

// Brings the frames of a drive to the server: in order, in chunks, within the credit that it
// grants, again from where the server asks for, over as many connections as it takes.
class Uploader {
 public:
  using Clock = std::function<std::chrono::steady_clock::time_point()>;

  Uploader(const std::shared_ptr<grpc::ChannelInterface>& channel, UploadOptions options,
           Clock clock, std::mt19937_64 random);

  // Returns when all frames are processed. A lost or draining server is tried again until
  // `give_up_after` has gone by without progress; every other error of the server is final and has
  // its sentence.
  absl::StatusOr<UploadResult> Upload(sources::FrameSource& source,
                                      const std::function<void(const UploadProgress&)>& progress);

  // Ends Upload() with Cancelled, now or as soon as it is called. On any thread.
  void Stop();

 private:
  absl::Status Attempt(sources::FrameSource& source);
  // Returns when the call is over: whether all had been sent. An error when the source cannot be
  // read or a frame not be sent.
  absl::StatusOr<bool> SendFrames(IngestStream& stream, sources::FrameSource& source);
  void Report(const std::string& trouble = {});
  void NoteProgress(const Watermarks& watermarks);
  std::unique_ptr<grpc::ClientContext> MakeContext() const;
  absl::Status FromServer(const grpc::Status& status);

  // Waits so long, or until it is stopped; whether it is.
  bool Stopped(std::chrono::milliseconds time);
  void SetContext(grpc::ClientContext* context);

  const UploadOptions options_;
  const Clock clock_;
  std::mt19937_64 random_;
  const std::unique_ptr<v1::SessionService::Stub> sessions_;
  const std::unique_ptr<v1::IngestService::Stub> ingest_;
  std::function<void(const UploadProgress&)> progress_;

  UploadResult result_;
  UploadProgress now_;
  bool progressed_ = false;                   // in the attempt at hand
  std::chrono::milliseconds asked_delay_{0};  // by the server's last error

  std::mutex mutex_;
  std::condition_variable stop_;
  bool stopped_ = false;                    // guarded by mutex_
  grpc::ClientContext* context_ = nullptr;  // of the call that runs; guarded by mutex_
};

}  // namespace soundmap::uplink
