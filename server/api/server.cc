#include "api/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>

#include <chrono>
#include <thread>

#include "absl/strings/str_cat.h"
#include "api/backup_service.h"
#include "api/ingest_service.h"
#include "api/live_service.h"
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
constexpr int kMaxCallsPerConnection = 512;
// Between the word that this server stops and the end of the streams: who spreads the load hears of
// it and sends nobody here any more.
constexpr std::chrono::milliseconds kNoticeTime(300);
constexpr std::chrono::seconds kDrainTime(2);

class GrpcServer : public Server {
 public:
  explicit GrpcServer(const Parts& parts)
      : sites_(parts.sites, parts.access),
        sessions_(parts.sites, parts.access, parts.store, parts.now_ns),
        ingest_(parts.sites, parts.access, parts.executor),
        live_(parts.sites, parts.access, parts.executor, parts.now_ns),
        robots_(parts.sites, parts.access),
        sound_map_(parts.sites, parts.access, parts.store),
        maps_(parts.sites, parts.access, parts.operations, parts.executor, parts.import_patience),
        operations_(parts.operations, parts.access),
        tuning_(parts.sites, parts.access, parts.operations),
        backups_(parts.store, parts.operations, parts.access, parts.backup_dir),
        watches_(parts.sites, parts.access, parts.executor, parts.server_id) {}

  absl::Status Listen(const std::string& address, const TlsFiles& tls) {
    const absl::Status checked = CheckTlsFiles(tls);
    if (!checked.ok()) return checked;
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort(address, GrpcCredentials(tls), &port);
    // Otherwise two servers share a port in silence.
    builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
    // Dead peers are found in half a minute; clients may ping every 10 s.
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
    builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 10'000);
    builder.AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, 10'000);
    builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, kMaxCallsPerConnection);
    builder.SetMaxReceiveMessageSize(kMaxMessageBytes);
    // The limit above is of what arrives; a compressed message may become a thousand times larger.
    builder.SetCompressionAlgorithmSupportStatus(GRPC_COMPRESS_GZIP, false);
    builder.SetCompressionAlgorithmSupportStatus(GRPC_COMPRESS_DEFLATE, false);
    for (grpc::Service* service : std::initializer_list<grpc::Service*>{
             &sites_, &sessions_, &ingest_, &live_, &robots_, &sound_map_, &maps_, &operations_,
             &backups_, &tuning_, &watches_}) {
      builder.RegisterService(service);
    }
    reading_ = builder.AddCompletionQueue();
    server_ = builder.BuildAndStart();
    if (!server_ || port == 0) {
      return absl::UnavailableError(absl::StrCat("cannot listen on the gRPC address ", address,
                                                 ": the port is busy or not allowed"));
    }
    reader_ = std::thread([this] {
      void* tag = nullptr;
      bool ok = false;
      while (reading_->Next(&tag, &ok)) {
      }
    });
    address_ = absl::StrCat(address.substr(0, address.rfind(':')), ":", port);
    server_->GetHealthCheckService()->SetServingStatus(true);
    return absl::OkStatus();
  }

  std::string address() const override { return address_; }

  void Shutdown() override {
    server_->GetHealthCheckService()->SetServingStatus(false);
    std::this_thread::sleep_for(kNoticeTime);
    ingest_.Drain();
    live_.Drain();
    server_->Shutdown(std::chrono::system_clock::now() + kDrainTime);
    server_->Wait();
    reading_->Shutdown();
    reader_.join();
  }

 private:
  SiteService sites_;
  SessionService sessions_;
  IngestService ingest_;
  LiveService live_;
  RobotService robots_;
  SoundMapService sound_map_;
  MapService maps_;
  OperationService operations_;
  TuningService tuning_;
  BackupService backups_;
  WatchService watches_;
  // gRPC's threads look after the connections only when no call waits for them, and while calls are
  // many or slow nobody gets in, and who answers a ping counts as dead. This queue has no calls:
  // the thread that waits at it looks after the connections, and runs no code of ours.
  std::unique_ptr<grpc::ServerCompletionQueue> reading_;
  std::unique_ptr<grpc::Server> server_;
  std::thread reader_;
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
