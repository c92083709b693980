#pragma once

#include <grpcpp/security/server_credentials.h>

#include <memory>
#include <string>

#include "absl/status/status.h"

namespace soundmap::api {

// Files that TLS needs, PEM. Those who serve read them again when they change.
struct TlsFiles {
  std::string certificate;  // the server's, then those between it and the root; empty: plain text
  std::string key;
  std::string client_ca;  // who signs the robots' certificates; empty: none is asked for

  bool on() const { return !certificate.empty(); }
};

// InvalidArgument, naming the file: it cannot be read, key and certificate are not a pair, or the
// certificate has expired.
absl::Status CheckTlsFiles(const TlsFiles& files);

// A client may show a certificate and must then show a good one.
std::shared_ptr<grpc::ServerCredentials> GrpcCredentials(const TlsFiles& files);

}  // namespace soundmap::api
