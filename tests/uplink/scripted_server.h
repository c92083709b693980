#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "google/rpc/status_details.pb.h"
#include "soundmap/v1/ingest_service.grpc.pb.h"
#include "soundmap/v1/session_service.grpc.pb.h"

namespace soundmap::uplink {

struct ReceivedFrame {
  v1::Sensor sensor = v1::SENSOR_UNSPECIFIED;
  std::int64_t log_time_ns = 0;
  std::string payload;
  bool operator==(const ReceivedFrame&) const = default;
};

// What the server does on one connection, beside taking frames.
struct Connection {
  std::optional<std::int64_t> fail_at_offset;  // when it comes, the stream ends with `failure`
  grpc::Status failure = grpc::Status(grpc::StatusCode::UNAVAILABLE, "Socket closed");
  std::optional<std::int64_t> rewind_at_offset;  // when it comes first, `rewind_to` is asked for
  std::int64_t rewind_to = 0;
  std::optional<std::int64_t> drain_at_offset;
  grpc::Status refuse_session = grpc::Status::OK;  // the answer to CreateSession
  std::vector<v1::Coding> codings;                 // that it offers
};

// A server that keeps what it is sent and complains of everything that breaks the protocol. Frames
// are kept over connections; `connections` says what happens on each, and the last goes on for
// ever.
class ScriptedServer final : public v1::IngestService::Service, public v1::SessionService::Service {
 public:
  ScriptedServer(std::int64_t credit_bytes, std::vector<Connection> connections);
  ~ScriptedServer() override;

  // Listens at a free port, or at `port`.
  void Start(int port = 0);
  void Stop();
  int port() const { return port_; }
  std::string address() const;

  // What it has, and what went wrong.
  std::vector<ReceivedFrame> frames() const;
  std::vector<std::string> complaints() const;
  int connection_count() const;
  v1::CreateSessionRequest session_request() const;
  std::string authorization() const;
  std::int64_t payload_bytes() const;  // that came, coded

  grpc::Status CreateSession(grpc::ServerContext* context, const v1::CreateSessionRequest* request,
                             v1::Session* response) override;
  grpc::Status Ingest(
      grpc::ServerContext* context,
      grpc::ServerReaderWriter<v1::IngestResponse, v1::IngestRequest>* stream) override;

 private:
  void Complain(const std::string& what);
  const Connection& Script(int index) const;

  const std::int64_t credit_bytes_;
  const std::vector<Connection> connections_;
  int port_ = 0;
  std::unique_ptr<grpc::Server> server_;

  mutable std::mutex mutex_;
  std::vector<ReceivedFrame> frames_;
  std::vector<std::string> complaints_;
  v1::CreateSessionRequest session_request_;
  std::string authorization_;
  std::int64_t epoch_ = 0;
  std::int64_t payload_bytes_ = 0;
  int session_count_ = 0;
};

}  // namespace soundmap::uplink
