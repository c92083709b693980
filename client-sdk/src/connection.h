#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <memory>
#include <string>

#include "absl/random/random.h"
#include "absl/status/statusor.h"
#include "retry.h"
#include "soundmap/client.h"
#include "soundmap/v1/backup_service.grpc.pb.h"
#include "soundmap/v1/map_service.grpc.pb.h"
#include "soundmap/v1/operation_service.grpc.pb.h"
#include "soundmap/v1/robot_service.grpc.pb.h"
#include "soundmap/v1/session_service.grpc.pb.h"
#include "soundmap/v1/site_service.grpc.pb.h"
#include "soundmap/v1/sound_map_service.grpc.pb.h"
#include "soundmap/v1/tuning_service.grpc.pb.h"
#include "soundmap/v1/watch_service.grpc.pb.h"
#include "status.h"

namespace soundmap {

// The channel, the stubs on it and the way of calling them. Immutable: any thread may use it.
class Client::Connection {
 public:
  enum class Repeat { kNever, kOnUnavailable };

  Connection(const ClientOptions& options, const std::shared_ptr<grpc::Channel>& channel);

  // A context with the token and, if `timeout` is positive, a deadline that far from now.
  void Prepare(grpc::ClientContext& context, std::chrono::milliseconds timeout) const;

  absl::Status Error(const grpc::Status& status) const {
    return internal::ToAbslStatus(status, options.server);
  }

  // Runs `attempt(context)` -> absl::Status with a fresh context. An Unavailable attempt is
  // repeated if it had no effect to speak of: `repeatable()` is asked after each.
  template <typename Attempt, typename Repeatable>
  absl::Status Try(std::chrono::milliseconds timeout, const Attempt& attempt,
                   const Repeatable& repeatable) const {
    internal::Backoff backoff(options.retry);
    for (int count = 1;; ++count) {
      grpc::ClientContext context;
      Prepare(context, timeout);
      const absl::Status status = attempt(context);
      if (!absl::IsUnavailable(status) || count >= options.retry.max_attempts || !repeatable()) {
        return status;
      }
      absl::BitGen random;
      Sleep(backoff.Next(random));
    }
  }

  // One unary call, e.g. Call<v1::Site>(Repeat::kOnUnavailable, *sites,
  // &v1::SiteService::Stub::GetSite, request).
  template <typename Response, typename Stub, typename Request>
  absl::StatusOr<Response> Call(Repeat repeat, Stub& stub,
                                grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&,
                                                             Response*),
                                const Request& request,
                                std::chrono::milliseconds extra_time = {}) const {
    Response response;
    const absl::Status status = Try(
        options.call_timeout + extra_time,
        [&](grpc::ClientContext& context) {
          response.Clear();
          return Error((stub.*method)(&context, request, &response));
        },
        [&] { return repeat == Repeat::kOnUnavailable; });
    if (!status.ok()) return status;
    return response;
  }

  // One server stream. `message` returns whether to read on. Repeated on Unavailable as long as
  // nothing was read.
  template <typename Response, typename Stub, typename Request, typename OnMessage>
  absl::Status Stream(Stub& stub,
                      std::unique_ptr<grpc::ClientReader<Response>> (Stub::*method)(
                          grpc::ClientContext*, const Request&),
                      const Request& request, const OnMessage& on_message) const {
    bool read_any = false;
    return Try(
        options.stream_timeout,
        [&](grpc::ClientContext& context) {
          const auto reader = (stub.*method)(&context, request);
          Response response;
          while (reader->Read(&response)) {
            read_any = true;
            if (!on_message(response)) {
              context.TryCancel();
              reader->Finish();
              return absl::OkStatus();
            }
          }
          return Error(reader->Finish());
        },
        [&] { return !read_any; });
  }

  const ClientOptions options;
  const std::unique_ptr<v1::SiteService::Stub> sites;
  const std::unique_ptr<v1::MapService::Stub> maps;
  const std::unique_ptr<v1::SoundMapService::Stub> sound_maps;
  const std::unique_ptr<v1::RobotService::Stub> robots;
  const std::unique_ptr<v1::SessionService::Stub> sessions;
  const std::unique_ptr<v1::WatchService::Stub> watches;
  const std::unique_ptr<v1::OperationService::Stub> operations;
  const std::unique_ptr<v1::TuningService::Stub> tuning;
  const std::unique_ptr<v1::BackupService::Stub> backups;

 private:
  static void Sleep(std::chrono::milliseconds time);
};

}  // namespace soundmap
