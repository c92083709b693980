#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "uplink/channel.h"

namespace soundmap {

// Where the server is and the files that open its door; empty: none.
struct ServerFiles {
  std::string address = "127.0.0.1:7443";
  std::string token_file;
  std::string tls_ca;    // PEM, as the next two
  std::string tls_cert;  // the robot's own
  std::string tls_key;
};

// NotFound: a file cannot be read.
absl::StatusOr<uplink::ServerOptions> ReadServerOptions(const ServerFiles& files);

}  // namespace soundmap
