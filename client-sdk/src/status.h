#pragma once

#include <grpcpp/support/status.h>

#include <string>

#include "absl/status/status.h"

namespace soundmap::internal {

// The server's own sentences pass unchanged; what gRPC says about the connection becomes a sentence
// that names `server` (HOST:PORT).
absl::Status ToAbslStatus(const grpc::Status& status, const std::string& server);

}  // namespace soundmap::internal
