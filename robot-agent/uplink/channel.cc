#include "uplink/channel.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace soundmap::uplink {
namespace {

bool IsLoopback(const std::string& address) {
  const std::string host = address.substr(0, address.rfind(':'));
  return host == "localhost" || host == "[::1]" || absl::StartsWith(host, "127.");
}

}  // namespace

absl::StatusOr<std::shared_ptr<grpc::Channel>> OpenChannel(const ServerOptions& options,
                                                           bool own_connection) {
  if (options.tls_cert_pem.empty() != options.tls_key_pem.empty() ||
      (!options.tls_cert_pem.empty() && options.tls_ca_pem.empty())) {
    return absl::InvalidArgumentError(
        "the robot's certificate, its key and the certificates to trust go together");
  }
  std::shared_ptr<grpc::ChannelCredentials> credentials = grpc::InsecureChannelCredentials();
  if (!options.tls_ca_pem.empty()) {
    grpc::SslCredentialsOptions ssl;
    ssl.pem_root_certs = options.tls_ca_pem;
    ssl.pem_cert_chain = options.tls_cert_pem;
    ssl.pem_private_key = options.tls_key_pem;
    credentials = grpc::SslCredentials(ssl);
  } else if (!options.token.empty() && !IsLoopback(options.address)) {
    return absl::InvalidArgumentError(absl::StrCat("the token would travel unencrypted to ",
                                                   options.address,
                                                   ": name the certificates to trust"));
  }
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 20'000);
  if (own_connection) arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  // The back-off is the caller's.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 50);
  // How long one attempt may take: a slow link needs some round trips of a second.
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 10'000);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 200);
  return grpc::CreateCustomChannel(options.address, credentials, arguments);
}

}  // namespace soundmap::uplink
