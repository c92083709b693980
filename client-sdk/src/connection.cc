#include "connection.h"

#include <openssl/bio.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include <memory>
#include <thread>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace soundmap {
namespace {

bool IsHostAndPort(const std::string& server) {
  const std::size_t colon = server.rfind(':');
  if (colon == std::string::npos || colon == 0) return false;
  const std::string host = server.substr(0, colon);
  const bool bracketed = host.front() == '[' && host.back() == ']' && host.size() > 2;
  if (!bracketed && host.find_first_of(":/[] \t\n") != std::string::npos) return false;
  int port = 0;
  return absl::SimpleAtoi(server.substr(colon + 1), &port) && port >= 1 && port <= 65535;
}

bool IsLoopback(const std::string& server) {
  return absl::StartsWith(server, "127.") || absl::StartsWith(server, "localhost:") ||
         absl::StartsWith(server, "[::1]:");
}

// gRPC takes anything here and fails at each call.
bool HoldsCertificate(const std::string& pem) {
  const std::unique_ptr<BIO, decltype(&BIO_free)> text(
      BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())), BIO_free);
  const std::unique_ptr<X509, decltype(&X509_free)> certificate(
      PEM_read_bio_X509(text.get(), nullptr, nullptr, nullptr), X509_free);
  return certificate != nullptr;
}

grpc::ChannelArguments Arguments(const ClientOptions& options) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 5'000);  // how long one attempt may take
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 5'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, IsLoopback(options.server) ? 0 : 1);
  // Clients of one process to one server would share a connection, its state and its back-off.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  arguments.SetMaxReceiveMessageSize(16 << 20);
  return arguments;
}

}  // namespace

Client::Connection::Connection(const ClientOptions& options,
                               const std::shared_ptr<grpc::Channel>& channel)
    : options(options),
      sites(v1::SiteService::NewStub(channel)),
      maps(v1::MapService::NewStub(channel)),
      sound_maps(v1::SoundMapService::NewStub(channel)),
      robots(v1::RobotService::NewStub(channel)),
      sessions(v1::SessionService::NewStub(channel)),
      watches(v1::WatchService::NewStub(channel)),
      operations(v1::OperationService::NewStub(channel)),
      tuning(v1::TuningService::NewStub(channel)),
      backups(v1::BackupService::NewStub(channel)) {}

void Client::Connection::Prepare(grpc::ClientContext& context,
                                 std::chrono::milliseconds timeout) const {
  if (timeout.count() > 0) {
    // A time span: gRPC adds it to its monotonic clock.
    context.set_deadline(gpr_time_from_millis(timeout.count(), GPR_TIMESPAN));
  }
  if (!options.token.empty()) {
    context.AddMetadata("authorization", absl::StrCat("Bearer ", options.token));
  }
}

void Client::Connection::Sleep(std::chrono::milliseconds time) {
  std::this_thread::sleep_for(time);
}

absl::StatusOr<Client> Client::Connect(const ClientOptions& options) {
  if (!IsHostAndPort(options.server)) {
    return absl::InvalidArgumentError(
        absl::StrCat("the server \"", options.server, "\" is not of the form HOST:PORT"));
  }
  for (const unsigned char c : options.token) {
    if (!absl::ascii_isgraph(c)) {
      return absl::InvalidArgumentError("the token contains a character that no token may have");
    }
  }
  if (options.call_timeout.count() <= 0 || options.stream_timeout.count() <= 0 ||
      options.retry.max_attempts < 1 || options.retry.initial_backoff.count() < 0 ||
      options.retry.max_backoff.count() < 0) {
    return absl::InvalidArgumentError(
        "a time-out, a number of attempts or a back-off of the client options is not positive");
  }
  std::shared_ptr<grpc::ChannelCredentials> credentials;
  if (!options.tls_ca_pem.empty()) {
    if (!HoldsCertificate(options.tls_ca_pem)) {
      return absl::InvalidArgumentError("tls_ca_pem holds no certificate in PEM form");
    }
    grpc::SslCredentialsOptions ssl;
    ssl.pem_root_certs = options.tls_ca_pem;
    credentials = grpc::SslCredentials(ssl);
  } else if (options.token.empty() || IsLoopback(options.server)) {
    credentials = grpc::InsecureChannelCredentials();
  } else {
    return absl::InvalidArgumentError(absl::StrCat("the token would travel unencrypted to ",
                                                   options.server,
                                                   ": name the certificates to trust"));
  }
  return Client(std::make_shared<Connection>(
      options, grpc::CreateCustomChannel(options.server, credentials, Arguments(options))));
}

}  // namespace soundmap
