#include "api/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>

#include <chrono>
#include <fstream>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "api/ingest_service.h"
#include "api/map_service.h"
#include "api/operation_service.h"
#include "api/robot_service.h"
#include "api/session_service.h"
#include "api/site_service.h"
#include "api/sound_map_service.h"
#include "api/tuning_service.h"
#include "api/watch_service.h"

namespace soundmap::api {
namespace {

// A message of the ingest stream has 256 KiB of payload, a chunk of a map file as much.
constexpr int kMaxMessageBytes = 1 << 20;
constexpr std::chrono::seconds kDrainTime(2);

absl::StatusOr<std::string> ReadPem(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream bytes;
  if (!file || !(bytes << file.rdbuf())) {
    return absl::NotFoundError(absl::StrCat("cannot read the TLS file ", path));
  }
  return std::move(bytes).str();
}

absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> CredentialsFrom(const TlsFiles& tls) {
  if (tls.certificate.empty()) return grpc::InsecureServerCredentials();
  const auto certificate = ReadPem(tls.certificate);
  if (!certificate.ok()) return certificate.status();
  const auto key = ReadPem(tls.key);
  if (!key.ok()) return key.status();
  grpc::SslServerCredentialsOptions options(
      tls.client_ca.empty() ? GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE
                            : GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  options.pem_key_cert_pairs.push_back({*key, *certificate});
  if (!tls.client_ca.empty()) {
    const auto client_ca = ReadPem(tls.client_ca);
    if (!client_ca.ok()) return client_ca.status();
    options.pem_root_certs = *client_ca;
  }
  return grpc::SslServerCredentials(options);
}

class GrpcServer : public Server {
 public:
  explicit GrpcServer(const Parts& parts)
      : sites_(parts.sites),
        sessions_(parts.sites, parts.store, parts.now_ns),
        ingest_(parts.sites, parts.executor),
        robots_(parts.sites),
        sound_map_(parts.sites, parts.store),
        maps_(parts.sites, parts.operations),
        operations_(parts.operations),
        tuning_(parts.sites, parts.operations),
        watches_(parts.sites, parts.executor, parts.server_id) {}

  absl::Status Listen(const std::string& address, const TlsFiles& tls) {
    const auto credentials = CredentialsFrom(tls);
    if (!credentials.ok()) return credentials.status();
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort(address, *credentials, &port);
    // Otherwise two servers share a port in silence.
    builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
    // Dead peers are found in half a minute; clients may ping every 10 s.
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
    builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 10'000);
    builder.SetMaxReceiveMessageSize(kMaxMessageBytes);
    for (grpc::Service* service :
         std::initializer_list<grpc::Service*>{&sites_, &sessions_, &ingest_, &robots_, &sound_map_,
                                               &maps_, &operations_, &tuning_, &watches_}) {
      builder.RegisterService(service);
    }
    server_ = builder.BuildAndStart();
    if (!server_ || port == 0) {
      return absl::UnavailableError(absl::StrCat("cannot listen on the gRPC address ", address,
                                                 ": the port is busy or not allowed"));
    }
    address_ = absl::StrCat(address.substr(0, address.rfind(':')), ":", port);
    server_->GetHealthCheckService()->SetServingStatus(true);
    return absl::OkStatus();
  }

  std::string address() const override { return address_; }

  void Shutdown() override {
    server_->GetHealthCheckService()->SetServingStatus(false);
    ingest_.Drain();
    server_->Shutdown(std::chrono::system_clock::now() + kDrainTime);
    server_->Wait();
  }

 private:
  SiteService sites_;
  SessionService sessions_;
  IngestService ingest_;
  RobotService robots_;
  SoundMapService sound_map_;
  MapService maps_;
  OperationService operations_;
  TuningService tuning_;
  WatchService watches_;
  std::unique_ptr<grpc::Server> server_;
  std::string address_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Server>> Server::Start(const std::string& address,
                                                      const TlsFiles& tls, const Parts& parts) {
  auto server = std::make_unique<GrpcServer>(parts);
  const absl::Status listening = server->Listen(address, tls);
  if (!listening.ok()) return listening;
  return server;
}

}  // namespace soundmap::api
