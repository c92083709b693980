#pragma once

#include <grpcpp/support/status.h>

#include "absl/status/status.h"

namespace soundmap::api {

// The same code and sentence, with google.rpc.ErrorInfo, and RetryInfo where trying again later
// helps.
grpc::Status ToGrpcStatus(const absl::Status& status);

}  // namespace soundmap::api
