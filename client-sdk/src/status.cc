#include "status.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace soundmap::internal {
namespace {

// gRPC 1.51's own words for a broken transport; none of them is a sentence for a reader.
std::string TransportSentence(const std::string& message, const std::string& server) {
  using absl::StrContains;
  if (StrContains(message, "DNS resolution failed") || StrContains(message, "C-ares status") ||
      StrContains(message, "empty address list")) {
    return absl::StrCat("the host name of the server ", server, " cannot be resolved");
  }
  if (StrContains(message, "Ssl handshake") || StrContains(message, "SSL_ERROR") ||
      StrContains(message, "Handshake failed") || StrContains(message, "handshake failed") ||
      StrContains(message, "Peer name")) {
    return absl::StrCat("the TLS handshake with the server at ", server, " failed");
  }
  if (StrContains(message, "failed to connect") || StrContains(message, "Failed to connect") ||
      StrContains(message, "connections to all backends failing")) {
    return absl::StrCat("cannot reach the server at ", server,
                        StrContains(message, "Connection refused") ? ": connection refused" : "");
  }
  if (StrContains(message, "Socket closed") || StrContains(message, "Connection reset") ||
      StrContains(message, "GOAWAY") || StrContains(message, "Broken pipe") ||
      StrContains(message, "keepalive") || StrContains(message, "Endpoint closing") ||
      StrContains(message, "Transport closed")) {
    return absl::StrCat("the connection to the server at ", server, " broke");
  }
  return message;
}

}  // namespace

absl::Status ToAbslStatus(const grpc::Status& status, const std::string& server) {
  if (status.ok()) return absl::OkStatus();
  std::string message = status.error_message();
  switch (status.error_code()) {
    case grpc::StatusCode::UNAVAILABLE:
    case grpc::StatusCode::UNKNOWN:
      message = TransportSentence(message, server);
      break;
    case grpc::StatusCode::DEADLINE_EXCEEDED:
      message = absl::StrCat("the server at ", server, " did not answer in time");
      break;
    case grpc::StatusCode::UNIMPLEMENTED:
      if (message.empty()) message = absl::StrCat("the server at ", server, " cannot do this");
      break;
    case grpc::StatusCode::CANCELLED:
      if (message.empty() || message == "CANCELLED") message = "the call was cancelled";
      break;
    default:
      break;
  }
  const auto code = static_cast<absl::StatusCode>(status.error_code());
  if (message.empty()) {
    message = absl::StrCat("the server at ", server, " answered ", absl::StatusCodeToString(code));
  }
  return absl::Status(code, message);
}

}  // namespace soundmap::internal
