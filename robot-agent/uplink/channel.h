#pragma once

#include <grpcpp/grpcpp.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace soundmap::uplink {

struct ServerOptions {
  std::string address;     // HOST:PORT
  std::string token;       // bearer token; empty: none. Needs TLS unless the server is on loopback.
  std::string tls_ca_pem;  // certificates to trust (PEM text); empty: plain text
  std::string tls_cert_pem;  // the robot's own certificate and its key; empty: none is shown
  std::string tls_key_pem;
};

// A channel that finds out within 40 s that its peer is dead. It connects when it is first used;
// channels to one server share a connection, but for those of their own.
// InvalidArgument: the token would travel unencrypted, or the
// certificate lacks its key or those to trust.
absl::StatusOr<std::shared_ptr<grpc::Channel>> OpenChannel(const ServerOptions& options,
                                                           bool own_connection = false);

}  // namespace soundmap::uplink
